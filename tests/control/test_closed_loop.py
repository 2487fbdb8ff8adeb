"""The law with the bench's gains, in a loop with noise, delay, jitter, stalls, wrong parameters and leaks."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import BENCH_GAINS, Scenario, simulate

from servohil.estimators.models.cylinder import CylinderParameters

NOMINAL = CylinderParameters()


def test_tracks_the_bench_sine() -> None:
    run = simulate(BENCH_GAINS, Scenario())
    assert run.rmse_m() <= 5e-5  # the product's bound is 1 mm
    assert np.abs(run.error_m(0.0)).max() <= 1e-3  # from the first cycle on
    assert run.chatter_v() <= 0.05


def test_jitter_stalls_and_more_delay_are_survived() -> None:
    run = simulate(BENCH_GAINS, Scenario(jitter=True, stall_every_s=0.5, late_cycles=1, seed=2))
    assert run.rmse_m() <= 1e-4
    assert run.chatter_v() <= 0.05


@pytest.mark.parametrize("valve", [0.8, 1.2])
@pytest.mark.parametrize("bulk", [0.8, 1.2])
def test_wrong_parameters_cost_less_than_half_a_millimetre(valve: float, bulk: float) -> None:
    truth = replace(NOMINAL, valve_gain=valve * NOMINAL.valve_gain, bulk_modulus_pa=bulk * NOMINAL.bulk_modulus_pa)
    assert simulate(BENCH_GAINS, Scenario(truth=truth)).rmse_m() <= 5e-4


@pytest.mark.parametrize("kind", ["internal", "external_a", "external_b"])
def test_a_leak_does_not_shake_the_loop(kind: str) -> None:
    run = simulate(BENCH_GAINS, Scenario(leak=1e-11, leak_at_s=4.0, leak_kind=kind, jitter=True))
    assert run.rmse_m(4.0) <= 5e-4
    assert np.abs(run.error_m()).max() <= 5e-3
    assert run.chatter_v() <= 0.05


def test_hold_from_full_speed_comes_to_rest() -> None:
    run = simulate(BENCH_GAINS, Scenario(hold_at_s=4.71))
    begin = int(4.71 / 1e-3)
    assert abs(run.truth[begin, 1]) > 0.29
    error = run.truth[begin:, 0] - run.reference[begin:, 0]
    assert np.abs(error).max() <= 0.02
    assert np.abs(error[-1000:]).max() <= 2e-4
