"""Can the outputs tell the states: the Lie-derivative rank at a state, and the empirical Gramian along a trajectory.

The rank (P3 3.2) is a yes or no: the gradients of y, L_f y, .. L_f^(n-1) y must span the state space. It is taken of
exact derivatives, in units of the states' typical sizes. The Gramian (Lall, Marsden & Glavaski 2002; Krener & Ide 2009)
says how well: it compares how much the outputs of a record move with each start state against the sensors' noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial, inf
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.integrate import STAGES
from servohil.estimators.jets.jet import Jet
from servohil.estimators.jets.on_jets import on_jets
from servohil.estimators.model import VECTOR, Model

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Singular values below this share of the largest count as zero: jets are exact to rounding, differences are not.
LIE_TOLERANCE: Final = 1e-10
GRAMIAN_TOLERANCE: Final = 1e-8
SHOWN: Final = 0.05  # parts of a direction smaller than this share of the largest are not worth a word

# The model: `Model.specialise` compiles `difference_along` with its functions and sizes in place of these.
f: Any = None
h: Any = None
integrate: Any = None
subtract_y: Any = None
N: int = 0
M: int = 0
DT: float = 0.0
SUBSTEPS: int = 0

SIGNATURE: Final = f"void({VECTOR}, {VECTOR}, f8[:, ::1], {VECTOR}, {VECTOR}, f8[:, ::1])"


class ObservabilityError(ValueError):
    """The question cannot be answered; the message names the argument, its value and the rule."""


@dataclass(frozen=True)
class Observability:
    """How strongly each direction of the state space shows in the outputs, states in units of their typical sizes."""

    strengths: Vector  # (n,) singular values, descending
    directions: Matrix  # (n, n) unit vectors by rows, belonging to them; scaled states
    tolerance: float  # share of the largest strength below which a direction is not observable
    scales: Vector  # (n,) typical sizes
    names: tuple[str, ...]
    units: tuple[str, ...]

    @property
    def rank(self) -> int:
        """Number of observable directions."""
        return int((self.strengths > self.tolerance * self.strengths[0]).sum())

    @property
    def condition(self) -> float:
        """Largest strength over the smallest; inf where the rank is not full."""
        return float(self.strengths[0] / self.strengths[-1]) if self.rank == len(self.strengths) else inf

    @property
    def gramian(self) -> Matrix:
        """(n, n) in scaled states; its eigenvalues are the squares of the strengths."""
        return (self.directions.T * self.strengths**2) @ self.directions

    @property
    def weakest(self) -> Vector:
        """(n,) the direction that shows least: a step of length 1 in scaled states, in the states' units."""
        return self.directions[-1] * self.scales

    @property
    def state_std(self) -> Vector:
        """(n,) least standard deviation, in the states' units, that any estimator of the start state can have from the
        record alone (Cramer-Rao, no process noise); inf for a state with a part that is not observable. Gramian only.
        """
        seen = self.rank
        variance = ((self.directions[:seen] / self.strengths[:seen, None]) ** 2).sum(axis=0)
        hidden = (np.abs(self.directions[seen:]) > self.tolerance).any(axis=0)
        return np.where(hidden, inf, self.scales * np.sqrt(variance))

    def describe_weakest(self, length: float = 1.0) -> str:
        """A step along the weakest direction in words: "+0.04 MPa pressure_b with +0.01 MPa pressure_a"."""
        share = np.abs(self.directions[-1])
        order = [int(i) for i in np.argsort(-share) if share[i] >= SHOWN * share.max()]
        sign = np.sign(self.directions[-1][order[0]])
        step = sign * length * self.weakest
        parts = [" ".join(f"{step[i]:+.2g} {self.units[i]} {self.names[i]}".split()) for i in order]
        return " with ".join(parts)


def lie_observability(
    model: Model, x: ArrayLike, u: ArrayLike, scales: ArrayLike, outputs: Sequence[int] | None = None
) -> Observability:
    """Rank of the gradients of the first n Lie derivatives of the outputs, at one state and constant input.

    Each output is taken in units in which its own gradient is 1, time in units in which the derivatives do not grow. A
    model that is discrete has h(f(.. f(x))) in place of Lie derivatives.

    Args:
        model: its plain Python functions are differentiated exactly.
        x: (n,) state.
        u: (n_u,) input.
        scales: (n,) typical sizes of the states, > 0: what counts as much.
        outputs: channels of y that are measured; None: all.

    Raises:
        ObservabilityError: wrong sizes, or a model that has no derivatives there or uses what cannot be differentiated.
    """
    typical = _positive("scales", scales, model.n)
    chosen = _channels(outputs, model.m)
    rows = lie_gradients(model, x, u)[:, chosen] * typical
    sizes = np.linalg.norm(rows, axis=2)  # (n, outputs)
    unit = np.where(sizes[0] > 0.0, sizes[0], sizes.max(axis=0))
    rows = rows / np.where(unit > 0.0, unit, 1.0)[None, :, None]
    if model.integrator != "discrete":
        growth = np.linalg.norm(rows, axis=(1, 2))
        with np.errstate(divide="ignore"):
            fastest = max(((growth[k] / max(growth[0], 1.0)) ** (1.0 / k) for k in range(1, model.n)), default=0.0)
        if fastest > 0.0:
            rows = rows / (fastest ** np.arange(model.n))[:, None, None]
    return _judge(rows.reshape(-1, model.n), LIE_TOLERANCE, typical, model)


def lie_gradients(model: Model, x: ArrayLike, u: ArrayLike) -> NDArray[np.float64]:
    """(n, m, n) gradients of L_f^k h_c for k = 0 .. n - 1 (discrete models: of h_c(f^k(x))), by jets.

    Raises:
        ObservabilityError: as `lie_observability`.
    """
    n = model.n
    start, held = _finite("x", x, n), _finite("u", u, model.n_u)
    functions = [on_jets(model.f), on_jets(model.h)]
    p = np.empty(len(model.p), dtype=object)  # a copy that can hold jets: a model may keep states there for a moment
    for i, parameter in enumerate(model.p):
        p[i] = parameter
    orders = 1 if model.integrator == "discrete" else n
    state = []
    for i in range(n):
        c = np.zeros((orders, 1 + n))
        c[0, 0], c[0, 1 + i] = start[i], 1.0
        state.append(Jet(c))
    try:
        with np.errstate(all="ignore"):
            if model.integrator == "discrete":
                rows = []
                for k in range(n):
                    rows.append([jet.c[0, 1:] for jet in _call(functions[1], state, held, p, model.m)])
                    for _ in range(model.substeps if k < n - 1 else 0):
                        state = _call(functions[0], state, held, p, n)
                gradients = np.array(rows)
            else:
                for k in range(1, n):
                    slopes = _call(functions[0], state, held, p, n)
                    for jet, slope in zip(state, slopes, strict=True):
                        jet.c[k] = slope.c[k - 1] / k
                seen = _call(functions[1], state, held, p, model.m)
                gradients = np.array([[factorial(k) * jet.c[k, 1:] for jet in seen] for k in range(n)])
    except Exception as error:
        raise ObservabilityError(
            f"f or h cannot be differentiated at x = {start}: {type(error).__name__}: {error}"
        ) from error
    if not np.isfinite(gradients).all():
        raise ObservabilityError(f"f or h has no finite derivative at x = {start}")
    return gradients


def gramian_observability(
    model: Model, x0: ArrayLike, U: ArrayLike, scales: ArrayLike, noise_std: ArrayLike,
    outputs: Sequence[int] | None = None, perturbation: float = 1e-3,
) -> Observability:  # fmt: skip
    """Empirical observability Gramian of the start state over the record of inputs U: W = sum_k J_k' R^-1 J_k.

    J_k = dy_k / dx0 by central differences of two simulations; y_k is taken after step k, as in a filter. The strengths
    are square roots of W's eigenvalues: their inverses are standard deviations in units of the typical sizes.

    Args:
        model: simulated.
        x0: (n,) state before the first input.
        U: (N, n_u) inputs.
        scales: (n,) typical sizes of the states, > 0.
        noise_std: (m,) standard deviations of the outputs' noise, > 0.
        outputs: channels of y that are measured; None: all.
        perturbation: of each start state, as a share of its typical size.

    Raises:
        ObservabilityError: wrong sizes, or a simulation that does not stay finite.
    """
    typical, noise = _positive("scales", scales, model.n), _positive("noise_std", noise_std, model.m)
    (share,) = _positive("perturbation", [perturbation], 1)
    chosen = _channels(outputs, model.m)
    start = _finite("x0", x0, model.n)
    inputs = np.array(U, dtype=np.float64, order="C")
    if inputs.ndim != 2 or inputs.shape[1] != model.n_u or not len(inputs):
        raise ObservabilityError(f"U has shape {inputs.shape}: must be (N, {model.n_u}), N >= 1")
    compiled = model.specialise(difference_along, SIGNATURE)
    jacobian = np.empty((len(inputs), model.m, model.n))
    work, moved = np.empty(STAGES * model.n + 2 * model.m), np.empty((len(inputs), model.m))
    for i in range(model.n):
        step = np.zeros(model.n)
        step[i] = share * typical[i]
        compiled(start + step, start - step, inputs, model.p, work, moved)
        jacobian[:, :, i] = moved / (2.0 * share * noise)
    if not np.isfinite(jacobian).all():
        raise ObservabilityError("U: the simulated outputs do not stay finite")
    return _judge(jacobian[:, chosen].reshape(-1, model.n), GRAMIAN_TOLERANCE, typical, model)


def difference_along(above: Vector, below: Vector, U: Matrix, p: Vector, work: Vector, out: Matrix) -> None:
    """Fill out (N, m) with the difference of the outputs of two simulations that start at `above` and `below`."""
    n = N
    m = M
    stages = work[: 5 * n].reshape((5, n))
    y_above = work[5 * n : 5 * n + m]
    y_below = work[5 * n + m : 5 * n + 2 * m]
    for k in range(U.shape[0]):
        integrate(f, n, DT, SUBSTEPS, above, U[k], p, stages)
        integrate(f, n, DT, SUBSTEPS, below, U[k], p, stages)
        h(above, U[k], p, y_above)
        h(below, U[k], p, y_below)
        subtract_y(y_above, y_below, out[k])


def _judge(rows: Matrix, tolerance: float, typical: Vector, model: Model) -> Observability:
    # One row of zeros per state, so that there are n singular values whatever the number of outputs is.
    _, strengths, directions = np.linalg.svd(np.vstack([rows, np.zeros((model.n, model.n))]), full_matrices=False)
    return Observability(strengths, directions, tolerance, typical, model.names, model.units)


def _call(function: Any, state: list[Jet], u: Vector, p: Vector, size: int) -> list[Jet]:
    arguments, out = np.empty(len(state), dtype=object), np.empty(size, dtype=object)
    arguments[:] = state
    function(arguments, u, p, out)
    zero = 0.0 * state[0]
    return [value if isinstance(value, Jet) else zero + float(value) for value in out]


def _finite(name: str, value: ArrayLike, size: int) -> Vector:
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise ObservabilityError(f"{name} = {value!r}: must be {size} finite numbers")
    return vector


def _positive(name: str, value: ArrayLike, size: int) -> Vector:
    vector = _finite(name, value, size)
    if not (vector > 0.0).all():
        raise ObservabilityError(f"{name} = {value!r}: must be > 0")
    return vector


def _channels(outputs: Sequence[int] | None, m: int) -> list[int]:
    chosen = list(range(m)) if outputs is None else [int(channel) for channel in outputs]
    if not chosen or not all(0 <= channel < m for channel in chosen):
        raise ObservabilityError(f"outputs = {outputs!r}: must be channels of y, 0 .. {m - 1}")
    return chosen
