"""The table of a campaign as Parquet: rows of plain values to typed columns, and back to arrays.

Any tool reads the file (pandas, polars, DuckDB, MATLAB); `read_table` gives plain numpy.
"""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Value = str | bool | int | float | None
Row = dict[str, Value]

TABLE: Final = "table.parquet"
METADATA: Final = b"servohil"  # key of the campaign's identity in the file


def plain_value(value: Any) -> Value:
    """`value` as a plain str, bool, int, float or None; numpy scalars are converted.

    Raises:
        ValueError: another type, or an int beyond 64 bits.
    """
    plain = value.item() if isinstance(value, np.generic) else value
    if isinstance(plain, int) and not -(2**63) <= plain < 2**63:
        raise ValueError(f"{value!r} does not fit in 64 bits")
    # Exactly these: an enumeration or a subclass would come back from the file as something else.
    if plain is not None and type(plain) not in (str, bool, int, float):
        raise ValueError(f"{value!r} is a {type(value).__name__}: expected a text, truth value, int or float")
    return plain


def column_type(name: str, values: Sequence[Value]) -> type:
    """str, bool, int or float: what a column of these values holds; ints beside floats are floats.

    Raises:
        ValueError: texts, truth values and numbers are mixed; the message names the column.
    """
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} and kinds != {int}:
        return float  # also where nothing was measured at all
    if len(kinds) > 1:
        raise ValueError(f"column {name!r} mixes {', '.join(sorted(kind.__name__ for kind in kinds))}")
    return kinds.pop()


def write_table(path: Path, rows: Sequence[Row], first: Sequence[str], last: str, about: Mapping[str, Any]) -> None:
    """Write the rows in the order given, so that a reader finds the whole file or none.

    Args:
        path: of the file.
        rows: a missing or None value becomes a null.
        first: columns that come first, in this order; the others follow in the order they turn up.
        last: the column that comes last.
        about: kept in the file's metadata as JSON.

    Raises:
        ValueError: a column mixes texts, truth values and numbers; the message names it.
    """
    import pyarrow
    from pyarrow import parquet

    types = {str: pyarrow.string(), bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64()}
    names = dict.fromkeys([*first, *(name for row in rows for name in row if name != last), last])
    columns = {}
    for name in names:
        values = [row.get(name) for row in rows]
        kind = column_type(name, values)
        if kind is float:  # whole numbers beyond 2**53 would be refused otherwise
            values = [None if value is None else float(value) for value in values]
        columns[name] = pyarrow.array(values, types[kind])
    table = pyarrow.table(columns).replace_schema_metadata({METADATA: json.dumps(dict(about))})
    unfinished = path.with_name(f".{path.name}")
    parquet.write_table(table, unfinished)
    os.replace(unfinished, path)


def read_table(path: Path) -> dict[str, NDArray[Any]]:
    """The columns by name: float64, int64, bool, or object for texts.

    Nulls are NaN in numbers (which makes int64 a float64) and None in texts and truth values (then objects).

    Raises:
        OSError: the file cannot be read, or is no Parquet file.
    """
    from pyarrow import ArrowInvalid, parquet

    try:
        table = parquet.read_table(path, use_threads=False)
    except ArrowInvalid as error:
        raise OSError(f"{path}: no Parquet file: {error}") from None
    return {name: column.to_numpy() for name, column in zip(table.column_names, table.columns, strict=True)}
