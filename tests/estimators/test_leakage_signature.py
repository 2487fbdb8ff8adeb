"""Signatures against what two filters see that differ by the change itself."""

from functools import cache

import numpy as np
import pytest
from hydraulic_bench import HEALTHY, model, sine_motion

from servohil.estimators import SRUKF
from servohil.estimators.leakage import signature
from servohil.estimators.leakage.changes import CHANGES, N_CHANGES, NAMES
from servohil.estimators.leakage.corrected import change_table, correct
from servohil.estimators.models import cylinder

Q = np.diag(np.square([1e-8, 3e-5, 2e-3, 2e-3]))
R = np.diag(np.square([20e-6, 0.02, 0.02]))
X0 = np.array([0.3, 0.3, 3.6, 5.75])
P0 = np.diag(np.square([1e-4, 1e-3, 0.02, 0.02]))
STEPS = 400


@cache
def motion():
    inputs, samples, _ = sine_motion(STEPS, 3, HEALTHY.vector(), HEALTHY.vector(), 10**9, 0, 0.0)
    return inputs, samples


def innovations(change: int | None, amount: float) -> np.ndarray:
    """(STEPS, 3) of a filter whose model has `amount` of the change taken in."""
    table, amounts = change_table(HEALTHY.vector()), np.zeros(N_CHANGES)
    if change is not None:
        amounts[change] = amount
    ukf = SRUKF(model(), X0, P0, Q, R)
    found = np.empty((STEPS, 3))
    for k, (input_, sample) in enumerate(zip(*motion(), strict=True)):
        p, u, y = HEALTHY.vector(), input_.copy(), sample.copy()
        correct(table, amounts, ukf.x[1], p, u, y)
        ukf._step(ukf.arena, ukf._work, p, u, y)
        found[k] = ukf.innovation
    return found


@cache
def signatures(missing: int | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """z (STEPS, 3), g (STEPS, 3, C), S (STEPS, 3, 3) and the innovations, of the healthy filter."""
    ukf = SRUKF(model(), X0, P0, Q, R)
    step = model().specialise(signature.advance_signatures, signature.SIGNATURE)
    table = change_table(HEALTHY.vector())
    state, out = np.zeros(N_CHANGES * 4), np.zeros(3 + 3 * N_CHANGES)
    scratch = np.zeros(signature.SCRATCH_SIZE)
    rows = []
    for u, sample in zip(*motion(), strict=True):
        last, y = ukf.x, sample.copy()
        if missing is not None:
            y[missing] = np.nan
        ukf.step(u, y)
        present = step(state, out, scratch, ukf.arena, last, np.concatenate([HEALTHY.vector(), u]), table)
        assert present == (3 if missing is None else 2)
        rows.append((out[:3].copy(), out[3:].reshape(3, N_CHANGES).copy(), ukf.S, ukf.innovation))
    z, g, s, e = (np.array(column) for column in zip(*rows, strict=True))
    return z, g, s, e


@pytest.mark.parametrize("change", range(N_CHANGES), ids=NAMES)
def test_a_signature_is_the_difference_of_two_filters(change: int) -> None:
    _, g, s, _ = signatures()
    amount = 0.3
    observed = (innovations(None, 0.0) - innovations(change, amount)) / amount
    unwhitened = np.einsum("kij,kj->ki", np.linalg.cholesky(s), g[:, :, change])
    assert np.abs(observed).max() > 0.0
    np.testing.assert_allclose(unwhitened, observed, atol=0.03 * np.abs(observed).max())


def test_whitening_is_by_the_covariance_of_the_innovation() -> None:
    z, _, s, e = signatures()
    for k in range(0, STEPS, 40):
        np.testing.assert_allclose(np.linalg.cholesky(s[k]) @ z[k], e[k], rtol=1e-9, atol=1e-15)
        assert z[k] @ z[k] == pytest.approx(e[k] @ np.linalg.solve(s[k], e[k]))


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_a_missing_channel_says_nothing_and_the_others_are_whitened_among_themselves(missing: int) -> None:
    z, g, s, e = signatures(missing)
    rest = [i for i in range(3) if i != missing]
    assert (z[:, missing] == 0.0).all() and (g[:, missing] == 0.0).all()
    for k in range(0, STEPS, 40):
        root = np.linalg.cholesky(s[k][np.ix_(rest, rest)])
        np.testing.assert_allclose(root @ z[k][rest], e[k][rest], rtol=1e-9, atol=1e-15)


def test_changes_are_put_in_and_taken_out_again() -> None:
    table = change_table(HEALTHY.vector())
    rng = np.random.default_rng(0)
    amounts = rng.normal(size=N_CHANGES)
    amounts[NAMES.index("overlap")] = 0.0  # acts by the valve, which the null moves
    p, u, y = HEALTHY.vector(), np.array([2.0, 14e6, 0.9e6]), np.array([0.3, 4.0, 6.0])
    correct(table, amounts, 0.2, p, u, y)
    by_name = dict(zip(NAMES, amounts, strict=True))
    assert p[cylinder.K_I] == pytest.approx(1e-13 * by_name["internal"])
    assert p[cylinder.CS] == pytest.approx(HEALTHY.valve_gain * (1.0 + 0.01 * by_name["valve_gain"]))
    assert p[cylinder.LOAD] == pytest.approx(10.0 * (by_name["load"] + by_name["dry_friction"]), rel=2e-3)
    assert u[0] == pytest.approx(2.0 + 0.01 * by_name["valve_null"])
    assert y[1] == pytest.approx(4.0 - 0.01 * by_name["sensor_a"]) and y[0] == 0.3
    u[0] = 2.0 if u[0] == 0.0 else u[0]
    correct(table, -amounts, 0.2, p, u, y)
    np.testing.assert_allclose(p, HEALTHY.vector(), rtol=1e-12, atol=1e-20)
    np.testing.assert_allclose(u, [2.0, 14e6, 0.9e6], rtol=1e-12)
    np.testing.assert_allclose(y, [0.3, 4.0, 6.0], rtol=1e-12)


def test_friction_acts_against_motion_and_overlap_against_the_opening() -> None:
    table = change_table(HEALTHY.vector())
    amounts = np.zeros(N_CHANGES)
    amounts[NAMES.index("dry_friction")] = 5.0
    amounts[NAMES.index("overlap")] = 20.0
    for sign in (1.0, -1.0):
        p, u, y = HEALTHY.vector(), np.array([sign * 3.0, 14e6, 0.9e6]), np.zeros(3)
        correct(table, amounts, sign * 0.3, p, u, y)
        assert p[cylinder.LOAD] == pytest.approx(sign * 50.0, rel=1e-3)
        assert u[0] == pytest.approx(sign * 2.8, rel=1e-4)
    assert {change.name for change in CHANGES if change.when} == {"dry_friction", "overlap"}
