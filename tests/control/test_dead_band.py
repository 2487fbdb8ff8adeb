"""The dead band and its inverse."""

import numpy as np
import pytest

from servohil.control.dead_band import RISE, opening, spool_for
from servohil.sim_bench.plants.cylinder import CylinderPlantParameters, flow_opening

BAND = 0.3


def test_the_opening_is_that_of_the_plant() -> None:
    p = CylinderPlantParameters(dead_band_v=BAND).vector()
    for spool in np.linspace(-9.0, 9.0, 301):
        assert opening(spool, BAND) == pytest.approx(flow_opening(spool, p), abs=1e-15)


def test_it_is_undone_outside_the_rise_and_never_reversed() -> None:
    for wanted in np.linspace(-5.0, 5.0, 1001):
        spool = spool_for(wanted, BAND)
        if abs(wanted) >= RISE * BAND:
            assert opening(spool, BAND) == pytest.approx(wanted, abs=1e-12)
        else:
            assert abs(opening(spool, BAND)) <= abs(wanted) and opening(spool, BAND) * wanted >= 0.0
        assert spool_for(wanted, 0.0) == wanted and opening(wanted, 0.0) == wanted
    steps = np.diff([spool_for(u, BAND) for u in np.linspace(-1.0, 1.0, 20001)])
    assert (steps > 0.0).all() and steps.max() <= 1e-4 * (1.0 + 1.0 / RISE) * 1.001  # continuous
