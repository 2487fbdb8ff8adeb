import numpy as np
import pytest
from hydraulic_bench import MEASUREMENT_STD, PROCESS_STD, healthy_motion, srukf

from servohil.estimators import filter as filter_module
from servohil.estimators.trajectory import run

STEPS = 60


def schedules():
    """Q of full rank, then of rank 1, then another in every step; R that grows."""
    rng = np.random.default_rng(1)
    q = np.tile(np.diag(PROCESS_STD**2), (STEPS, 1, 1))
    q[20:40] = np.outer(PROCESS_STD, PROCESS_STD)
    q[40:] *= rng.uniform(1, 9, size=(20, 1, 1))
    q[50:, 3, 3] *= np.arange(1, 11)
    q[50:, :3, :3] = q[50, :3, :3]
    r = np.diag(MEASUREMENT_STD**2) * np.linspace(1, 50, STEPS)[:, None, None]
    r[:, 1, 2] = r[:, 2, 1] = 0.4 * r[:, 1, 1]
    return q, r


def by_steps(ukf, inputs, samples, q, r):
    rows = []
    for k in range(STEPS):
        if q is not None:
            ukf.Q = q[k]
        if r is not None:
            ukf.R = r[k]
        status = ukf.step(inputs[k], samples[k])
        rows.append((ukf.x, ukf.P, ukf.innovation, ukf.nis, status))
    return rows


@pytest.mark.parametrize("given", ["QR", "Q", "R"])
@pytest.mark.parametrize("raises", [False, True])
def test_noise_that_changes_equals_setting_it_before_each_step_bit_for_bit(given, raises, monkeypatch):
    inputs, samples, _ = healthy_motion(STEPS)
    stacks = dict(zip("QR", schedules(), strict=True))
    q, r = (stacks[name] if name in given else None for name in "QR")
    one, other, constant = srukf(), srukf(), srukf()

    def raises_half_way(step, arena, work, p, u, *rest):
        run(step, arena, work, p, u[:30], *rest)
        raise ValueError

    if raises:
        monkeypatch.setattr(filter_module, "run", raises_half_way)
    rows = by_steps(one, inputs, samples, q, r)
    trajectory = other.run(inputs, samples, Q=q, R=r)
    for column, field in zip(zip(*rows, strict=True), ("x", "P", "innovation", "nis", "status"), strict=True):
        np.testing.assert_array_equal(np.array(column), getattr(trajectory, field), err_msg=field)
    assert one.arena.tobytes() == other.arena.tobytes()
    assert np.abs(constant.run(inputs, samples).x - trajectory.x).max() > 1e-3


def test_refusals_name_argument_step_and_rule():
    inputs, samples, _ = healthy_motion(STEPS)
    q, r = schedules()
    ukf = srukf()
    before = ukf.arena.tobytes()
    with pytest.raises(ValueError, match=r"Q has shape \(59, 4, 4\): must be \(60, 4, 4\), one for each step"):
        ukf.run(inputs, samples, Q=q[1:])
    with pytest.raises(ValueError, match=r"R has shape \(3, 3\): must be \(60, 3, 3\)"):
        ukf.run(inputs, samples, R=r[0])
    r[17, 0, 0] = -1.0
    with pytest.raises(ValueError, match=r"R\[17\] = .*semidefinite"):
        ukf.run(inputs, samples, Q=q, R=r)
    assert ukf.arena.tobytes() == before
