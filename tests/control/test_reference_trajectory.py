"""A trajectory: the compiled table against scipy's piecewise polynomial, its ends, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from reference_paths import at, septic_trajectory
from scipy.interpolate import BPoly, PPoly

from servohil.control.references import ProfileError, TrajectoryProfile

ONE = septic_trajectory(0.25, 0.4, 1.6)
LOOP = septic_trajectory(0.25, 0.4, 1.6, there_and_back=True)


def random_pieces(seed: int) -> tuple[TrajectoryProfile, PPoly]:
    """Pieces with random values of the four quantities at their joins (Hermite), at rest at both ends."""
    rng = np.random.default_rng(seed)
    breaks = np.concatenate(([0.0], np.cumsum(rng.uniform(0.2, 1.5, 9))))
    values = rng.normal(0.0, 1.0, (10, 4)) * [0.1, 0.1, 0.3, 1.0]
    values[[0, -1], 1:] = 0.0
    polynomial = PPoly.from_bernstein_basis(BPoly.from_derivatives(breaks, values))
    return TrajectoryProfile(breaks, np.ascontiguousarray(polynomial.c[::-1].T), blend_s=1e-6), polynomial


@pytest.mark.parametrize("seed", range(4))
def test_the_table_is_scipys_polynomial_and_its_derivatives(seed: int) -> None:
    profile, polynomial = random_pieces(seed)
    times = np.concatenate((np.random.default_rng(seed).uniform(1e-6, profile.period_s, 500), profile.breaks_s[1:-1]))
    for t_s in times:
        expected = [polynomial(t_s, derivative) for derivative in range(4)]
        np.testing.assert_allclose(at(profile, t_s), expected, rtol=1e-9, atol=1e-9)


def test_it_stays_at_its_last_position() -> None:
    for t_s in (1.6, 1.7, 900.0):
        assert at(ONE, t_s) == pytest.approx([0.4, 0.0, 0.0, 0.0], abs=1e-12)


def test_it_begins_again_where_that_is_asked_for() -> None:
    for t_s in (1.5, 2.9, 3.3):
        assert at(LOOP, t_s + 3.2) == pytest.approx(at(LOOP, t_s + 6.4), abs=1e-10)
    assert at(LOOP, 8.0)[0] == pytest.approx(0.4)
    assert LOOP.period_s == 3.2


def test_the_extremes_name_their_times() -> None:
    told = ONE.extremes()
    assert told.at_s[2] == pytest.approx(0.8)
    assert told.speed_mps == pytest.approx(0.15 * 35.0 / 16.0 / 1.6, rel=1e-9)
    with pytest.raises(ProfileError) as caught:
        ONE.check_limits(0.0, 1.0, 0.2)
    assert caught.value.at_s == pytest.approx(0.8)


def changed(row: int, power: int, by: float) -> np.ndarray:
    table = LOOP.coefficients.copy()
    table[row, power] += by
    return table


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"breaks_s": np.array([0.0, 1.6])}, r"shape \(2, 8\) for 2 breaks: must be \(1, 8\)"),
        ({"coefficients": LOOP.coefficients[:, :7]}, r"shape \(2, 7\) for 3 breaks: must be \(2, 8\)"),
        ({"breaks_s": np.array([0.0, 1.6, 1.6])}, "must begin with 0 and increase"),
        ({"breaks_s": np.array([0.1, 1.6, 3.2])}, "must begin with 0 and increase"),
        ({"coefficients": changed(1, 4, np.nan)}, "must be finite"),
        ({"coefficients": changed(1, 0, 0.01)}, "derivative 0 jumps, at 1.6 s"),
        ({"coefficients": changed(1, 1, 0.01)}, "derivative 1 jumps, at 1.6 s"),
        ({"coefficients": changed(1, 2, 0.01)}, "derivative 2 jumps, at 1.6 s"),
        ({"coefficients": changed(1, 3, 0.01)}, "derivative 3 jumps, at 1.6 s"),
        ({"coefficients": changed(1, 7, 0.01)}, "derivative 1 must be 0 at its begin and end"),
        ({"blend_s": 0.0}, "blend_s = 0.0"),
    ],
)
def test_what_cannot_be_followed_is_refused(changes: dict[str, object], text: str) -> None:
    with pytest.raises(ProfileError, match=text):
        replace(LOOP, **changes)


def test_what_does_not_close_is_not_repeated() -> None:
    with pytest.raises(ProfileError, match=r"ends at 0.4 m; it must end where it begins, at 0.25 m"):
        replace(ONE, repeat=True)
