"""The gain of the smooth variable structure filter (Habibi 2007; P2 reference 12), free of divisions by an innovation.

The correction of an output is (|e_k+1|k| + gamma |e_k|k|) sat(e_k+1|k / psi), with e_k|k the error that the last
correction left: the gain is (|e_k+1|k| + gamma |e_k|k|) / max(|e_k+1|k|, psi). Hidden states have the same with their
errors from `luenberger.hidden_errors`.
"""

from math import isnan

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy")
def svsf_gain(
    convergence: Vector, layer: Vector, phi: Matrix, n: int, m: int, innovation: Vector, memory: Vector, visible: bool,
    through: Matrix, before: Vector, now: Vector, gain: Matrix, change: Vector,
) -> None:  # fmt: skip
    """Fill gain (n, m) and change (n,), rows are outputs and hidden states; both arrive as zeros.

    Args:
        convergence: (n,) gamma.
        layer: (n,) psi; 0 for a hidden state: that of the outputs, carried through Phi22 Phi12^+.
        phi: (n, n) transformed system.
        n, m: numbers of states and outputs.
        innovation: (m,) NaN = missing.
        memory: see `manifold_update.py`.
        visible: whether the hidden errors are known.
        through: (n, m) Phi12^+ in its first n - m rows.
        before, now: (n - m,) hidden errors e_l,k|k and e_l,k+1|k.
        gain, change: filled.
    """
    for c in range(m):
        if not isnan(innovation[c]):
            size = abs(innovation[c])
            gain[c, c] = (size + convergence[c] * abs(memory[c])) / max(size, layer[c])
            change[c] = gain[c, c] * innovation[c]
    if visible:
        for j in range(n - m):
            width = layer[m + j]
            for c in range(m):
                for i in range(n - m):
                    gain[m + j, c] += phi[m + j, m + i] * through[i, c]
                if layer[m + j] == 0.0:
                    width += abs(gain[m + j, c]) * layer[c]
            width = max(width, abs(now[j]))
            scale = (abs(now[j]) + convergence[m + j] * abs(before[j])) / width if width > 0.0 else 0.0
            change[m + j] = scale * now[j]
            for c in range(m):
                gain[m + j, c] *= scale
