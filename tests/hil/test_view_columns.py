"""What the page plots: no extremum is lost on the way, and blocks carry what was put in."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.view.block import BlockError, decode_block, encode_block
from servohil.hil.view.columns import BUCKET_NS, NAMES, Columns, Recent, columns_of, extrema

MS = 1_000_000
finite = st.floats(-1e9, 1e9)


def naive(t_ns: list[int], values: list[float], bucket_ns: int) -> list[tuple[int, float]]:
    """The same by hand: per bucket one point alone as it is, else both extrema at its first and last time."""
    points = []
    for bucket in sorted({t // bucket_ns for t in t_ns}):
        inside = [(t, v) for t, v in zip(t_ns, values, strict=True) if t // bucket_ns == bucket]
        (first_t, first), (last_t, last) = inside[0], inside[-1]
        low, high = min(v for _, v in inside), max(v for _, v in inside)
        points.append((first_t, low if last >= first else high))
        if len(inside) > 1:
            points.append((last_t, high if last >= first else low))
    return points


@given(st.lists(st.tuples(st.integers(1, 5 * MS), finite), min_size=1, max_size=60))
def test_extrema_are_those_found_by_hand(samples: list[tuple[int, float]]) -> None:
    t_ns = np.cumsum([step for step, _ in samples])
    values = [value for _, value in samples]
    times, kept = extrema(t_ns, np.array([values]), BUCKET_NS)
    assert list(zip(times.tolist(), kept[0].tolist(), strict=True)) == naive(t_ns.tolist(), values, BUCKET_NS)


def test_every_column_keeps_its_own_peak_of_one_sample() -> None:
    rng = np.random.default_rng(1)
    t_ns = np.arange(1000) * MS
    values = rng.normal(size=(3, 1000))
    for column, place in enumerate((3, 500, 996)):
        values[column, place] = 50.0 * (-1) ** column
    times, kept = extrema(t_ns, values, BUCKET_NS)
    assert len(times) == 250
    for column, place in enumerate((3, 500, 996)):
        at = np.argmax(np.abs(kept[column]))
        assert kept[column, at] == values[column, place]
        assert abs(times[at] - t_ns[place]) < BUCKET_NS


def test_a_value_beside_a_missing_one_is_kept_and_a_gap_stays_a_gap() -> None:
    t_ns = np.arange(16) * MS
    values = np.full((1, 16), np.nan)
    values[0, 3] = 7.0
    times, kept = extrema(t_ns, values, BUCKET_NS)
    assert times.tolist() == [0, 7 * MS, 8 * MS, 15 * MS]
    assert kept[0, :2].tolist() == [7.0, 7.0] and np.isnan(kept[0, 2:]).all()


def rows(n: int, period_ns: int = 20 * MS) -> NDArray[np.void]:
    """SNAPSHOT (n,), slow enough that nothing is decimated."""
    made = np.zeros(n, SNAPSHOT)
    made["t_ns"] = 5_000_000_000 + np.arange(n) * period_ns
    made["position_m"] = np.linspace(0.1, 0.4, n)
    made["est_pressure_b_pa"], made["std_pressure_b_pa"] = 4e6, 1e4
    return made


def test_columns_are_the_snapshots_fields_and_a_band_of_two_sigma() -> None:
    columns = columns_of(rows(4))
    assert columns.t_s.tolist() == [5.0, 5.02, 5.04, 5.06]
    assert columns.values[NAMES.index("position_m")] == pytest.approx(rows(4)["position_m"], rel=1e-6)
    assert columns.values[NAMES.index("low_pressure_b_pa")].tolist() == [3.98e6] * 4
    assert columns.values[NAMES.index("high_pressure_b_pa")].tolist() == [4.02e6] * 4


@given(st.integers(0, 40), st.integers(0, 9), st.randoms())
def test_a_block_brings_back_what_was_put_in(n: int, k: int, random: object) -> None:
    rng = np.random.default_rng(abs(hash(random)) % 2**32)
    put = Columns(rng.normal(size=n), rng.normal(size=(k, n)).astype(np.float32))
    got = decode_block(encode_block(put))
    assert got.t_s.tobytes() == put.t_s.tobytes() and got.values.tobytes() == put.values.tobytes()
    assert got.values.shape == (k, n)


def test_a_block_lies_as_a_browser_reads_it() -> None:
    block = encode_block(Columns(np.array([1.5, 2.5]), np.array([[10, 20], [30, 40], [50, 60]], np.float32)))
    assert struct.unpack("<4sIII2d6f", block) == (b"HILV", 1, 2, 3, 1.5, 2.5, 10, 20, 30, 40, 50, 60)


@pytest.mark.parametrize("damage", [lambda b: b[:15], lambda b: b[:-1], lambda b: b + b"x", lambda b: b"X" + b[1:],
                                    lambda b: b[:4] + b"\2" + b[5:]])  # fmt: skip
def test_what_is_no_block_is_refused(damage: object) -> None:
    block = encode_block(columns_of(rows(3)))
    with pytest.raises(BlockError, match="block"):
        decode_block(damage(block))  # type: ignore[operator]


def test_recent_keeps_the_last_seconds_and_forgets_a_run_that_is_over() -> None:
    recent = Recent(1.0)
    assert recent.all() is None
    for second in range(4):
        recent.add(Columns(np.array([second, second + 0.5]), np.full((1, 2), second, np.float32)))
    kept = recent.all()
    assert kept is not None and kept.t_s.tolist() == [2.0, 2.5, 3.0, 3.5]
    recent.add(Columns(np.array([0.1]), np.zeros((1, 1), np.float32)))
    kept = recent.all()
    assert kept is not None and kept.t_s.tolist() == [0.1]
