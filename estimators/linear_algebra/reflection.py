"""A reflection of four neighbouring columns, in one vector register: the inner loops of every QR.

numba leaves LLVM's vectoriser of straight-line code switched off, so that four sums side by side become four times as
many instructions. Here they are written as vectors of four; a processor without such registers takes them in parts.
"""

from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import lower_builtin, type_callable
from numba.np.arrayobj import make_array
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Index = int | np.uint64

LANES: Final = 4
_LANE = ir.DoubleType()
_LANES = ir.VectorType(_LANE, LANES)
_INDEX = ir.IntType(64)


def reflect_four(array: Matrix, k: Index, j: Index, first: Index, rows: Index, v: float, scale: float) -> None:
    """Apply I - scale w w' to columns j .. j + 3, where w is v in row k and column k of the array in rows first ..

    Args:
        array: C-contiguous (>= rows, >= j + 4), changed in place. Column k may be among the four: each row is read
            before it is written.
        k, j, first, rows: unsigned.
        v, scale: of the reflection.
    """
    column, block = array[first:rows, k], array[first:rows, j : j + LANES]
    sums = scale * (v * array[k, j : j + LANES] + column @ block)
    array[k, j : j + LANES] -= v * sums
    block -= np.outer(column, sums)


@type_callable(reflect_four)
def _type(context: Any) -> Any:
    def typer(array: Any, k: Any, j: Any, first: Any, rows: Any, v: Any, scale: Any) -> Any:
        square = isinstance(array, types.Array) and array.ndim == 2 and array.layout == "C"
        return types.void if square and array.dtype == types.float64 else None

    return typer


@lower_builtin(reflect_four, types.Array, *[types.Integer] * 4, types.Float, types.Float)
def _reflect_four(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    array = make_array(signature.args[0])(context, builder, arguments[0])
    k, j, first, rows = (
        context.cast(builder, value, kind, types.uint64)
        for value, kind in zip(arguments[1:5], signature.args[1:5], strict=True)
    )
    width = cgutils.unpack_tuple(builder, array.shape)[1]

    def at(row: Any, column: Any) -> Any:
        return builder.gep(array.data, [builder.add(builder.mul(row, width), column)], inbounds=True)

    def four(row: Any) -> Any:
        return builder.bitcast(at(row, j), _LANES.as_pointer())

    def all_lanes(value: Any) -> Any:
        one = builder.insert_element(ir.Constant(_LANES, ir.Undefined), value, _INDEX(0))
        return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))

    def subtract(row: Any, factor: Any, sums: Any) -> None:
        left = builder.fsub(builder.load(four(row), align=8), builder.fmul(all_lanes(factor), sums))
        builder.store(left, four(row), align=8)

    v, scale = arguments[5], arguments[6]
    sums = cgutils.alloca_once(builder, _LANES)
    builder.store(builder.fmul(all_lanes(v), builder.load(four(k), align=8)), sums)
    with cgutils.for_range_slice(builder, first, rows, _INDEX(1), inc=True) as (i, _):
        product = builder.fmul(all_lanes(builder.load(at(i, k))), builder.load(four(i), align=8))
        builder.store(builder.fadd(builder.load(sums), product), sums)
    scaled = builder.fmul(all_lanes(scale), builder.load(sums))
    subtract(k, v, scaled)
    with cgutils.for_range_slice(builder, first, rows, _INDEX(1), inc=True) as (i, _):
        subtract(i, builder.load(at(i, k)), scaled)
    return context.get_dummy_value()
