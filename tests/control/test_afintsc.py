"""AFINTSC: FINTSC with mu from the fuzzy system, bit for bit; bad numbers; the rig file's keys."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from servohil.control.fuzzy.adaptive_mu import FUZZY_SIZE, LOW, FuzzyMu, mu_type1, mu_type2
from servohil.control.laws.afintsc import AfintscGains, afintsc_step
from servohil.control.laws.fintsc import MU, FintscGains, fintsc_step
from servohil.control.laws.law import FLAGS, INTEGRAL, NOT_FINITE, RUNNING, STATE_SIZE, GainError
from servohil.hil.config.control import Afintsc

Array = np.ndarray
COEFFICIENTS = {2: (1.0, 10.1), 3: (2.72, 0.24, 0.10), 4: (4.0, 6.0, 4.0, 1.0)}
LAW: dict[str, Any] = {
    "alpha1": 1.02, "power": 1.2, "switching_gain": 2.0, "boundary_layer": 0.1, "epsilon": 1e-3,
    "singularity_bound": 0.5,
}  # fmt: skip
FUZZY: dict[str, Any] = {"error_scale": 0.5, "rate_scale": 1.5, "footprint": 0.1, "gamma": 0.8}
TYPES = {"type1": mu_type1, "type2": mu_type2}


def adaptive(order: int = 2, fuzzy: str = "type2") -> AfintscGains:
    return AfintscGains(c=COEFFICIENTS[order], fuzzy=fuzzy, **LAW, **FUZZY)


def plain(order: int, mu: float) -> Array:
    return FintscGains(mu=mu, c=COEFFICIENTS[order], **LAW).vector()


def states(order: int) -> Array:
    return np.random.default_rng(order).normal(0.0, 0.4, (300, order))


def plant(order: int, k: int) -> tuple[Any, ...]:
    return (np.full(order + 1, 0.1), 0.3 * np.sin(k), 2.0, 1.5, -50.0, 50.0, 1e-2)


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("fuzzy", ["type1", "type2"])
def test_with_constant_consequents_it_is_fintsc(fuzzy: str, order: int) -> None:
    gains = adaptive(order, fuzzy).vector()
    fuzzy_part = slice(gains.size - 1 - FUZZY_SIZE + LOW, gains.size - 1)
    gains[fuzzy_part] = 0.37
    one, other = np.zeros(STATE_SIZE), np.zeros(STATE_SIZE)
    for k, e in enumerate(states(order)):
        u = afintsc_step(one, gains, e, *plant(order, k))
        assert u == fintsc_step(other, plain(order, 0.37), e, *plant(order, k))
        np.testing.assert_array_equal(one, other)
    assert one[INTEGRAL] != 0.0


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("fuzzy", ["type1", "type2"])
def test_mu_is_that_of_error_and_rate(fuzzy: str, order: int) -> None:
    gains, settings = adaptive(order, fuzzy).vector(), FuzzyMu(**FUZZY).vector()
    one, other, seen = np.zeros(STATE_SIZE), np.zeros(STATE_SIZE), set()
    for k, e in enumerate(states(order)):
        mu = TYPES[fuzzy](settings, e[0], e[1])
        seen.add(mu)
        u = afintsc_step(one, gains, e, *plant(order, k))
        assert u == fintsc_step(other, plain(order, mu), e, *plant(order, k))
    assert max(seen) - min(seen) > 0.4


def test_the_types_differ_and_mu_of_the_law_itself_has_no_say() -> None:
    e, commands = np.array([0.2, 0.3]), {}
    for fuzzy in TYPES:
        gains = adaptive(2, fuzzy).vector()
        for mu in (0.1, 0.9):
            gains[MU] = mu
            state = np.zeros(STATE_SIZE)
            state[RUNNING], state[INTEGRAL] = 1.0, 0.2
            commands[fuzzy, mu] = afintsc_step(state, gains, e, *plant(2, 0))
    assert commands["type1", 0.1] == commands["type1", 0.9] != commands["type2", 0.1] == commands["type2", 0.9]


@pytest.mark.parametrize("fuzzy", ["type1", "type2"])
def test_the_error_of_a_double_integrator_vanishes(fuzzy: str) -> None:
    gains, state, e, dt = adaptive(2, fuzzy).vector(), np.zeros(STATE_SIZE), np.array([0.5, 0.0]), 1e-3
    for _ in range(20_000):
        u = afintsc_step(state, gains, e, np.zeros(3), 0.0, 1.0, 1.0, -50.0, 50.0, dt)
        e = np.array([e[0] + dt * (e[1] + 0.5 * dt * u), e[1] + dt * u])
    assert np.abs(e).max() < 1e-3


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("fuzzy", ["type1", "type2"])
def test_a_bad_number_gives_zero_a_flag_and_changes_nothing(fuzzy: str, bad: float) -> None:
    size = adaptive(3, fuzzy).vector().size
    for place in range(3 + size):
        gains, e = adaptive(3, fuzzy).vector(), np.array([0.01, 0.02, 0.03])
        if place < 3:
            e[place] = bad
        else:
            gains[place - 3] = bad
        state = np.zeros(STATE_SIZE)
        state[RUNNING], state[INTEGRAL] = 1.0, 0.02
        assert afintsc_step(state, gains, e, *plant(3, 0)) == 0.0
        assert state[FLAGS] == NOT_FINITE
        assert state[INTEGRAL] == 0.02


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"fuzzy": "type3"}, "fuzzy = 'type3': must be 'type1' or 'type2'"),
        ({"footprint": 0.3}, "footprint = 0.3: must satisfy 0 <= footprint <= 0.15"),
        ({"error_scale": 0.0}, "error_scale = 0.0: must be > 0"),
        ({"gamma": -1.0}, "gamma = -1.0: must be > 0"),
        ({"power": 2.0}, "power = 2.0: must satisfy 1 < nu/rho < 2"),
        ({"epsilon": 0.0}, "epsilon = 0.0: must be > 0"),
        ({"c": (1.0, -1.0)}, r"c\[1\] = -1.0: must be > 0"),
    ],
)
def test_gains_name_the_condition_they_break(change: dict[str, Any], text: str) -> None:
    with pytest.raises(GainError, match=text):
        replace(adaptive(), **change)


def test_the_rig_files_keys_are_the_laws_gains() -> None:
    keys = {"law": "afintsc", "c": COEFFICIENTS[3], **LAW, "footprint": 0.1, "gamma": 0.8}
    scales = {"error_scale_m": "20 mm", "rate_scale_mps": 0.2}
    for extra, fuzzy in (({}, "type2"), ({"fuzzy": "type1"}, "type1")):
        section = Afintsc.model_validate({**keys, **scales, **extra})
        expected = replace(adaptive(3, fuzzy), error_scale=0.02, rate_scale=0.2)
        np.testing.assert_array_equal(section.gains(), expected.vector())
    for wrong in ({"footprint": 0.2}, {"fuzzy": "type3"}, {"error_scale_m": 0.0}, {"mu": 0.5}):
        with pytest.raises(ValidationError):
            Afintsc.model_validate({**keys, **scales, **wrong})


def test_compiled_equals_plain() -> None:
    interpreted = getattr(afintsc_step, "py_func", afintsc_step)
    one, other = np.zeros(STATE_SIZE), np.zeros(STATE_SIZE)
    for k, e in enumerate(states(3)[:50]):
        u = afintsc_step(one, adaptive(3).vector(), e, *plant(3, k))
        assert u == pytest.approx(interpreted(other, adaptive(3).vector(), e, *plant(3, k)), rel=1e-12)
