"""Vectors and matrices within a flat array: what a slice and `reshape` give, without their price in compiled code.

numba reshapes by a call that hides the sizes from the compiler, and counts references to every slice; a step has a
dozen of them. A view made here has the sizes that it was asked for and owns nothing: it must not outlive its base.
"""

from typing import Any

import numpy as np
from numba import types
from numba.extending import lower_builtin, type_callable
from numba.np.arrayobj import make_array, populate_array
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def vector_at(base: Vector | Matrix, start: int, size: int) -> Vector:
    """View of size elements from start on; the rows of a matrix count as one behind the other."""
    return base.reshape(-1)[start : start + size]


def matrix_at(base: Vector | Matrix, start: int, rows: int, columns: int) -> Matrix:
    """View of rows * columns elements of base from start on as (rows, columns)."""
    return base.reshape(-1)[start : start + rows * columns].reshape(rows, columns)


def _view_type(base: Any, dimensions: int) -> Any:
    flat = isinstance(base, types.Array) and base.layout == "C" and base.dtype == types.float64
    return types.Array(base.dtype, dimensions, "C") if flat else None  # None: numba refuses the call


@type_callable(vector_at)
def _vector_type(context: Any) -> Any:
    return lambda base, start, size: _view_type(base, 1)


@type_callable(matrix_at)
def _matrix_type(context: Any) -> Any:
    return lambda base, start, rows, columns: _view_type(base, 2)


@lower_builtin(vector_at, types.Array, types.Integer, types.Integer)
@lower_builtin(matrix_at, types.Array, types.Integer, types.Integer, types.Integer)
def _view(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    base = make_array(signature.args[0])(context, builder, arguments[0])
    start, *shape = (
        context.cast(builder, value, kind, types.intp)
        for value, kind in zip(arguments[1:], signature.args[1:], strict=True)
    )
    itemsize = context.get_constant(types.intp, 8)
    strides = [itemsize] if len(shape) == 1 else [builder.mul(shape[1], itemsize), itemsize]
    view = make_array(signature.return_type)(context, builder)
    data = builder.gep(base.data, [start], inbounds=True)
    populate_array(view, data=data, shape=shape, strides=strides, itemsize=itemsize, meminfo=None)
    return view._getvalue()
