"""The compiled filter and the same source run by the Python interpreter give the same numbers."""

import json
import os
import subprocess
import sys

import numpy as np

SCRIPT = """
import json
import numpy as np
from servohil.estimators import SRUKF, Model
from servohil.estimators.leakage.residual_monitor import ResidualMonitor
from servohil.estimators.models import cylinder

model = Model(cylinder.f, cylinder.h, 4, 3, cylinder.CylinderParameters().vector(), 1e-3, n_u=3)
ukf = SRUKF(
    model, [0.3, 0.1, 4.0, 6.0], np.diag([1e-6, 1e-4, 0.04, 0.04]), np.diag([1e-12, 1e-8, 4e-6, 4e-6]),
    np.diag([1.6e-9, 4e-4, 4e-4]), gate=0.99,
)
monitor = ResidualMonitor(1e-3, 2.0, 0.1, 5.0, 0.0)
rows = []
for k in range(40):
    y = np.array([0.3 + 1e-4 * k, 4.0 + 0.03 * np.sin(k), 6.0 + 0.03 * np.cos(k)])
    if k % 5 == 2:
        y[k % 3] = np.nan
    if k == 30:
        y[0] = np.inf
    status = ukf.step(np.array([np.cos(0.1 * k), 14e6, 0.9e6]), y)
    monitor.step(ukf.innovation[1:], np.diag(ukf.S)[1:].copy(), True)
    rows.append([status, *ukf.x, *ukf.P.ravel(), *ukf.S.ravel(), ukf.nis, ukf.loglik, *monitor.arena])
print(json.dumps(rows))
"""


def numbers(**environment: str) -> np.ndarray:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout))


def test_compiled_equals_plain():
    compiled, plain = numbers(NUMBA_DISABLE_JIT="0"), numbers(NUMBA_DISABLE_JIT="1")
    assert np.isfinite(compiled).all() and set(compiled[:, 0]) >= {0.0, 1.0, 8.0}
    np.testing.assert_allclose(compiled, plain, rtol=1e-10, atol=1e-12)
