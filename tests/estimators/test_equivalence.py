"""On linear systems every filter is the Kalman filter, with missing channels, over 1000 steps, to 1e-10."""

import numpy as np
import pytest
from linear_bench import excitation, random_system
from reference_filters import kalman

from servohil.estimators import SRUKF
from servohil.estimators.aekf import AEKF
from servohil.estimators.asrukf import ASRUKF
from servohil.estimators.aukf import AUKF
from servohil.estimators.ekf import EKF
from servohil.estimators.health import Status
from servohil.estimators.kf import KF
from servohil.estimators.ukf import UKF

# Those that adapt are, switched off, the compiled step of the one before.
FAMILY = (
    (KF, {}), (EKF, {}), (AEKF, {"adaptation": "off"}), (UKF, {}), (AUKF, {"adaptation": "off"}), (SRUKF, {}),
    (ASRUKF, {"adaptation": "off"}),
)  # fmt: skip
STEPS = 1000
TOLERANCE = 1e-10


def check(n, m, family):
    system, a, b, c, q, r, p0 = random_system(n, m)
    inputs, outputs = excitation(STEPS, m, n)
    x0 = np.random.default_rng(n).normal(size=n)
    x, p, rows = x0, p0, []
    for u, y in zip(inputs, outputs, strict=True):
        e = y - c @ (a @ x + b * u[0])
        x, p, s, loglik = kalman(a, b, c, q, r, x, p, u, y)
        seen = ~np.isnan(y)
        nis = e[seen] @ np.linalg.solve(s[np.ix_(seen, seen)], e[seen])
        rows.append((x, p, e, nis, Status.OK if seen.all() else Status.MISSING))
    expected = dict(zip(("x", "P", "innovation", "nis", "status"), zip(*rows, strict=True), strict=True))
    for kind, arguments in family:
        ours = kind(system, x0, p0, q, r, **arguments)
        run = ours.run(inputs, outputs)
        for field, values in expected.items():
            tolerance = {"rtol": 1e-9, "atol": 1e-9} if field == "nis" else {"rtol": 0, "atol": TOLERANCE}
            np.testing.assert_allclose(
                getattr(run, field), np.array(values), err_msg=f"{kind.__name__} {field}", **tolerance
            )
        np.testing.assert_allclose(ours.S, s, rtol=0, atol=TOLERANCE)
        assert ours.loglik == pytest.approx(loglik, abs=1e-9), kind


@pytest.mark.parametrize(("n", "m"), [(3, 1), (5, 3)])
def test_every_filter_is_the_kalman_filter(n, m):
    check(n, m, FAMILY)


def test_whatever_the_spread_of_the_points():
    check(5, 3, [(UKF, {"alpha": 0.6}), (SRUKF, {"alpha": 0.6}), (SRUKF, {"alpha": 1.7, "kappa": 0.5})])


@pytest.mark.nightly
@pytest.mark.parametrize(("n", "m"), [(n, m) for n in range(2, 12) for m in range(1, n + 1)])
def test_every_filter_is_the_kalman_filter_for_all_sizes(n, m):
    check(n, m, FAMILY)
