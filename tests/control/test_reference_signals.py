"""Ramp, chirp and PRBS: the speed, the frequency, the sequence."""

import numpy as np
import pytest
from reference_paths import at
from scipy.integrate import quad

from servohil.control.references import ChirpProfile, PrbsProfile, RampProfile
from servohil.control.references.prbs import TAPS, maximum_length_sequence

CHIRP = ChirpProfile(0.3, 0.05, 0.5, 3.0, 10.0, blend_s=1e-6)


@pytest.mark.parametrize(("jerk", "reached"), [(1e4, "acceleration"), (8.0, "jerk")])
def test_a_ramp_has_its_speed_between_roundings_within_both_limits(jerk: float, reached: str) -> None:
    profile = RampProfile(0.1, 0.5, 0.2, 1.5, jerk, pause_s=0.5, blend_s=1e-6)
    seen = np.array([at(profile, t_s) for t_s in np.linspace(1e-6, profile.move_s, 20001)])
    most = np.abs(seen).max(axis=0)
    assert most[1] == pytest.approx(0.2, rel=1e-12)
    assert (most[2] == pytest.approx(1.5, rel=1e-6)) == (reached == "acceleration")
    assert (most[3] == pytest.approx(jerk, rel=1e-6)) == (reached == "jerk")
    assert most[2] <= 1.5 * (1.0 + 1e-9) and most[3] <= jerk * (1.0 + 1e-9)
    fast = np.abs(seen[:, 1] - 0.2) < 1e-12
    assert fast.mean() == pytest.approx(1.0 - 2.0 * profile.rounding_s / profile.move_s, abs=0.02)
    assert seen[-1] == pytest.approx([0.5, 0.0, 0.0, 0.0], abs=1e-9)


def test_a_ramp_pauses_comes_back_and_begins_again() -> None:
    profile = RampProfile(0.1, 0.5, 0.2, 1.5, 100.0, pause_s=0.5)
    leg = profile.move_s + 0.5
    for legs, place in ((1, 0.5), (2, 0.1), (3, 0.5)):
        assert at(profile, legs * leg - 0.1) == pytest.approx([place, 0.0, 0.0, 0.0])
    assert at(profile, leg + 1.0)[1] == pytest.approx(-0.2)
    assert at(profile, profile.period_s + 2.5) == pytest.approx(at(profile, 2.0 * profile.period_s + 2.5))


def frequency(t_s: float) -> float:
    """Of the chirp, from its position and velocity alone: tan(phase) = phase' swing / velocity."""
    position, velocity, *_ = at(CHIRP, t_s)
    swing = position - 0.3
    return float(velocity / np.sqrt(0.05**2 - swing**2) / (2.0 * np.pi))


def test_the_chirp_runs_linearly_there_and_back() -> None:
    rate = 2.5 / (10.0 - 35.0 / 128.0)  # 35/128 s: what the two half turns take, see the next test but one
    for sweep in range(4):
        for x in np.random.default_rng(sweep).uniform(0.5, 9.5, 200):
            expected = 1.75 + (rate if sweep % 2 == 0 else -rate) * (x - 5.0)
            t_s = 10.0 * sweep + x
            if abs(at(CHIRP, t_s)[0] - 0.3) < 0.045:  # elsewhere the square root loses the digits
                assert abs(frequency(t_s)) == pytest.approx(expected, rel=1e-9)


def test_the_chirp_reaches_both_frequencies_at_its_turns() -> None:
    for t_s, expected in ((10.0, 3.0), (20.0, 0.5), (30.0, 3.0), (40.0, 0.5)):
        values = [(abs(at(CHIRP, t)[0] - 0.3), abs(frequency(t))) for t in t_s + np.linspace(-2e-2, 2e-2, 41)]
        assert min(values)[1] == pytest.approx(expected, rel=1e-3)


def test_the_phase_is_the_integral_of_the_documented_frequency() -> None:
    beta = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
    rate = 2.5 / quad(lambda t: slope(t, beta), 0.0, 10.0, points=[0.5, 9.5])[0]

    def hertz(t_s: float) -> float:
        edges = [edge for edge in (0.5, 9.5, 10.5, 19.5, 20.5) if edge < t_s]
        return 0.5 + rate * quad(slope, 0.0, t_s, args=(beta,), points=edges or None)[0]

    for t_s in (0.3, 2.0, 9.7, 10.2, 14.0, 19.8):
        edges = [edge for edge in (0.5, 9.5, 10.5, 19.5) if edge < t_s]
        phase = 2.0 * np.pi * quad(hertz, 0.0, t_s, points=edges or None, epsabs=1e-9)[0]
        assert at(CHIRP, t_s)[:2] == pytest.approx(
            [0.3 + 0.05 * np.sin(phase), 0.05 * np.cos(phase) * 2.0 * np.pi * hertz(t_s)], abs=1e-7
        )


def slope(t_s: float, beta: np.polynomial.Polynomial) -> float:
    """Of the frequency, over its greatest: +1 and -1 by turns, the septic within 0.5 s of each turn."""
    turn = round(t_s / 10.0)
    way = beta(min(max((t_s - 10.0 * turn + 0.5) / 1.0, 0.0), 1.0))
    sign = 1.0 if turn % 2 == 0 else -1.0  # after this turn
    return float(sign * (2.0 * way - 1.0))


def lfsr(order: int, seed: int) -> list[int]:
    """A Fibonacci shift register, bit by bit, until its state returns."""
    state, bits = seed, []
    while True:
        bits.append(state & 1)
        feedback = state & 1
        for tap in TAPS[order]:
            feedback ^= state >> tap & 1
        state = state >> 1 | feedback << (order - 1)
        if state == seed:
            return bits


@pytest.mark.parametrize("order", TAPS)
def test_the_sequence_is_of_maximum_length_balanced_and_white(order: int) -> None:
    n = 2**order - 1
    bits = maximum_length_sequence(order, seed=3)
    assert bits.tolist() == lfsr(order, 3)  # whose state returns after n steps and not before
    assert bits.size == n
    assert bits.sum() == 2 ** (order - 1)
    spectrum = np.fft.fft(2.0 * bits - 1.0)
    correlation = np.fft.ifft(np.abs(spectrum) ** 2).real / n
    np.testing.assert_allclose(correlation, [1.0] + [-1.0 / n] * (n - 1), atol=1e-9)


@pytest.mark.parametrize(("order", "seed"), [(7, 1), (9, 77), (12, 4095)])
def test_the_levels_are_the_bits_for_two_periods(order: int, seed: int) -> None:
    profile = PrbsProfile(0.2, 0.4, 0.1, 0.06, order, seed, blend_s=0.05)
    n = 2**order - 1
    bits = np.array([at(profile, 0.1 * (k + 0.9))[0] > 0.3 for k in range(2 * n)])
    assert bits.tolist() == [bit == 1 for bit in lfsr(order, seed) * 2]
    assert profile.period_s == pytest.approx(0.1 * n)
    assert at(profile, 0.1 * 5.61) == pytest.approx([at(profile, 0.1 * 5.99)[0], 0.0, 0.0, 0.0])


def test_another_seed_is_the_same_sequence_from_another_place() -> None:
    first, other = maximum_length_sequence(8, 1), maximum_length_sequence(8, 200)
    shifts = [k for k in range(255) if (np.roll(first, -k) == other).all()]
    assert len(shifts) == 1 and shifts[0] != 0
