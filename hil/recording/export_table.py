"""Snapshots as CSV and Parquet, every signal with its unit, on a time axis in seconds and on the wall clock."""

import csv
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.hil.recording.columns import SIGNALS, TIME, WALL, Block

NS_PER_S = 1_000_000_000


def seconds(block: Block) -> NDArray[np.float64]:
    """(n,) time since the loop started, s."""
    return np.asarray(block.snapshots["t_ns"]) * 1e-9


def heads() -> list[str]:
    """Column names of a table without metadata: the unit in brackets where the name does not end in it."""
    return [f"{TIME} [s]", WALL, *(f"{s.name} [{s.unit}]" for s in SIGNALS)]


def utc_text(unix_ns: int) -> str:
    """ISO 8601 with nanoseconds."""
    whole, rest = divmod(unix_ns, NS_PER_S)
    return f"{datetime.fromtimestamp(whole, UTC):%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"


def write_csv(blocks: Iterable[Block], out: Path) -> None:
    """One line per cycle; numbers with every digit, nothing where a signal is not a number."""
    with out.open("x", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(heads())
        for block in blocks:
            table.writerows(_lines(block))


def _lines(block: Block) -> Iterator[list[Any]]:
    times = seconds(block).tolist()
    for time_s, row in zip(times, block.snapshots.tolist(), strict=True):
        wall = utc_text(block.origin_ns + row[1]) if block.origin_ns else ""
        yield [f"{time_s:.9f}", wall, *("" if value != value else value for value in row)]  # noqa: PLR0124 - NaN


def write_parquet(blocks: Iterable[Block], out: Path, facts: dict[str, str]) -> None:
    """One row per cycle; unit and meaning in each column's metadata, `facts` in the file's."""
    import pyarrow as pa
    from pyarrow import parquet

    fields = [pa.field(TIME, pa.float64(), metadata={"unit": "s"}), pa.field(WALL, pa.timestamp("ns", tz="UTC"))]
    kinds = {"i": pa.int64(), "f": pa.float64()}
    schema = None
    with out.open("xb") as stream:
        writer: Any = None
        for block in blocks:
            rows = block.snapshots
            if schema is None:
                signals = [
                    pa.field(s.name, kinds[rows.dtype[s.name].kind], metadata={"unit": s.unit, "meaning": s.meaning})
                    for s in SIGNALS
                ]
                schema = pa.schema([*fields, *signals], metadata=facts)
                writer = parquet.ParquetWriter(stream, schema, compression="zstd")
            wall = rows["t_ns"] + block.origin_ns if block.origin_ns else None
            columns = [
                pa.array(seconds(block)),
                pa.nulls(len(rows), fields[1].type) if wall is None else pa.array(wall).cast(fields[1].type),
                *(pa.array(np.ascontiguousarray(rows[s.name])) for s in SIGNALS),
            ]
            writer.write_table(pa.Table.from_arrays(columns, schema=schema))
        if writer is not None:
            writer.close()
