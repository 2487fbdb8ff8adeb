"""The hand-written C filter of `srukf_peer.c`: compiled on the spot for this machine, called through ctypes."""

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.sim_bench.benchmarks.estimator_cases import Case

Matrix = NDArray[np.float64]

SOURCE: Final = Path(__file__).with_name("srukf_peer.c")
FLAGS: Final = ("-O3", "-march=native", "-shared", "-fPIC")
POINTER, DOUBLE = ctypes.c_void_p, ctypes.c_double


class PeerUnavailableError(Exception):
    """There is nothing to compare with on this machine; the message says why."""


class CPeer:
    """The C filter for one case.

    Args:
        case: the cylinder with 4 or 11 states.
        folder: where the library is put.

    Raises:
        PeerUnavailableError: no gcc, or it failed.
    """

    def __init__(self, case: Case, folder: Path) -> None:
        gcc = shutil.which("gcc")
        if gcc is None:
            raise PeerUnavailableError("no gcc")
        library = folder / f"srukf{case.model.n}.so"
        command = [gcc, *FLAGS, f"-DN={case.model.n}", str(SOURCE), "-o", str(library), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise PeerUnavailableError(f"gcc failed: {done.stderr.strip().splitlines()[-1:]}")
        self._run = ctypes.CDLL(str(library)).run
        self._run.restype = None
        self._run.argtypes = [
            ctypes.c_long, *[POINTER] * 4, *[DOUBLE] * 3, *[POINTER] * 3, DOUBLE, POINTER,
        ]  # fmt: skip
        self._case = case
        self._factors = [np.ascontiguousarray(np.linalg.cholesky(square).T) for square in (case.q, case.r)]
        self.estimates: Matrix = np.empty((len(case.inputs), case.model.n))  # of the last run
        self.prepare()

    def prepare(self) -> None:
        """Back to the start."""
        self._x = self._case.x0.copy()
        self._factor = np.ascontiguousarray(np.linalg.cholesky(self._case.p0).T)

    def run(self) -> None:
        """All steps."""
        case, weights = self._case, self._case.weights
        self._run(
            len(case.inputs), self._x.ctypes.data, self._factor.ctypes.data, *(f.ctypes.data for f in self._factors),
            weights.spread, weights.covariance_centre**0.5, weights.outer, case.model.p.ctypes.data,
            case.inputs.ctypes.data, case.samples.ctypes.data, case.model.dt, self.estimates.ctypes.data,
        )  # fmt: skip
