"""Plain numpy forms of the filters of P2, and the actuator with its faults. They share no code with the library."""

from dataclasses import replace

import numpy as np
from linear_bench import EHA_A, EHA_B, as_model
from numpy.typing import NDArray

from servohil.estimators.models import eha

Array = NDArray[np.float64]

ACCELERATION_STD, POSITION_STD = 0.05, 1e-6  # process noise per step m/s2, encoder noise m
EHA_Q = np.diag([1e-20, 1e-14, ACCELERATION_STD**2])
EHA_R = np.array([[POSITION_STD**2]])
EHA_P0 = np.diag([1e-10, 1e-6, 0.1])
# as printed in P2 section 6
PRINTED_Q, PRINTED_R, PRINTED_P0 = np.diag([1e3, 10.0, 1e2]), np.array([[1e-13]]), 10 * np.eye(3)
PRINTED_LAYERS, PRINTED_THRESHOLD_M2 = [1e-11, 1e-7, 1e-4], 0.3e-10
HEALTHY = eha.EhaParameters()
FRICTION = replace(HEALTHY, friction_viscous=3 * HEALTHY.friction_viscous, friction_dry_n=5 * HEALTHY.friction_dry_n)
LEAKAGE = replace(HEALTHY, leakage=30 * HEALTHY.leakage)
# the faulty plants move as the nonlinear model does, the healthy one as the linear: that is what "nominal" means
NONLINEAR = {id(HEALTHY): False, id(FRICTION): True, id(LEAKAGE): True}


def pump_motion(steps: int, seed: int, plants=((0, HEALTHY),), flow=6e-5):
    """Inputs (N, 1), measured positions (N, 1) and states (N, 3); `plants` names the plant from a step on."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=3) * np.sqrt(np.diag(EHA_P0))
    inputs, samples, states = np.zeros((steps, 1)), np.zeros((steps, 1)), np.zeros((steps, 3))
    parameters = HEALTHY
    changes = dict(plants)
    for k in range(steps):
        parameters = changes.get(k, parameters)
        u = np.array([flow * np.sign(np.sin(2 * np.pi * 2e-3 * k)) * (1 - np.exp(-k / 50))])
        if NONLINEAR[id(parameters)]:
            dx = np.zeros(3)
            eha.f(x, u, parameters.vector(), dx)
            x = x + eha.SAMPLE_TIME_S * dx
        else:
            x = EHA_A @ x + EHA_B * u[0]
        x[2] += ACCELERATION_STD * rng.normal()
        inputs[k], states[k], samples[k] = u, x, x[0] + POSITION_STD * rng.normal()
    return inputs, samples, states


class PlainManifoldFilter:
    """SVSF or dynamic second-order filter in the transformed coordinates of P2 section 5, for a linear model.

    The hidden errors are found from the prediction of eq. 63, which starts from the measured z_k, and not from the
    filter's innovation as in the library. K is the diagonal gain of the text.
    """

    def __init__(self, a, b, c, q, r, x, p, hidden):
        self.a, self.b, self.c, self.q, self.r, self.x, self.p = a, b, c, q, r, x.copy(), p.copy()
        self.t = np.vstack([c, np.eye(len(a))[hidden]])
        self.phi = self.t @ a @ np.linalg.inv(self.t)
        m = len(c)
        self.z = np.full(m, np.nan)  # measured last
        self.left, self.left_before, self.hidden_before = np.full(m, np.nan), np.full(m, np.nan), None

    def gain(self, e, s, before, now, through):
        raise NotImplementedError

    def step(self, u, y):
        a, c, m, n = self.a, self.c, len(self.c), len(self.a)
        estimated = self.t @ self.x
        self.x = a @ self.x + self.b * u[0]
        self.p = a @ self.p @ a.T + self.q
        s = c @ self.p @ c.T + self.r
        e = y - c @ self.x
        there = ~np.isnan(y)
        twice = there & ~np.isnan(self.z)
        before = now = through = None
        if n > m and twice.any():
            start = np.where(np.isnan(self.z), estimated[:m], self.z)
            predicted = self.phi @ np.concatenate([start, estimated[m:]]) + self.t @ self.b * u[0]
            inverse = np.linalg.pinv(self.phi[:m, m:][twice])
            before = inverse @ (y - predicted[:m])[twice]
            through = np.zeros((n - m, m))
            through[:, twice] = inverse
            now = self.phi[m:, m:] @ before + self.phi[m:, :m] @ (start - estimated[:m])
        gain, change = self.gain(e, s, before, now, through)
        gain[:, ~there] = 0.0
        back = np.linalg.inv(self.t)
        k = back @ gain
        joseph = np.eye(n) - k @ c
        self.p = joseph @ self.p @ joseph.T + k @ self.r @ k.T
        self.x = self.x + back @ change
        self.z = y.copy()
        self.left_before = np.where(np.isnan(self.left), e, self.left)
        self.left = y - c @ self.x
        self.hidden_before = before
        return e, s


class PlainSVSF(PlainManifoldFilter):
    """(|e| + gamma |e before|) sat(e / psi), element by element as printed by Habibi."""

    def __init__(self, *arguments, gamma, psi, hidden):
        super().__init__(*arguments, hidden)
        self.gamma, self.psi = gamma, psi

    def gain(self, e, s, before, now, through):
        n, m = len(self.a), len(e)
        gain, change = np.zeros((n, m)), np.zeros(n)
        for i in range(m):
            if not np.isnan(e[i]):
                memory = 0.0 if np.isnan(self.left[i]) else abs(self.left[i])
                change[i] = (abs(e[i]) + self.gamma[i] * memory) * np.clip(e[i] / self.psi[i], -1, 1)
                gain[i, i] = change[i] / e[i]
        if before is not None:
            rows = self.phi[m:, m:] @ through
            for j in range(n - m):
                psi = self.psi[m + j] if len(self.psi) > m else np.abs(rows[j]) @ self.psi
                size = abs(now[j]) + self.gamma[m + j] * abs(before[j])
                change[m + j] = size * np.clip(now[j] / psi, -1, 1)
                gain[m + j] = change[m + j] / now[j] * rows[j]
        return gain, change


class PlainSecondOrder(PlainManifoldFilter):
    """e - (gamma + Lambda) e_k + gamma Lambda e_k-1 (P2 eq. 12); the covariance's rules are ours."""

    def __init__(self, *arguments, gamma, cutoff, hidden):
        super().__init__(*arguments, hidden)
        self.gamma, self.cutoff = gamma, cutoff

    def gain(self, e, s, before, now, through):
        n, m = len(self.a), len(e)
        gain, change = np.zeros((n, m)), np.zeros(n)
        for i in range(m):
            if not np.isnan(e[i]):
                new = np.isnan(self.left[i])
                one, two = (e[i], e[i]) if new else (self.left[i], self.left_before[i])
                change[i] = e[i] - (self.gamma[i] + self.cutoff[i]) * one + self.gamma[i] * self.cutoff[i] * two
                divisor = np.sign(e[i]) * max(abs(e[i]), np.sqrt(s[i, i]))
                gain[i, i] = 1 - (e[i] - change[i]) / divisor
        if before is not None:
            gamma, cutoff = np.diag(self.gamma[m:]), np.diag(self.cutoff[m:])
            earlier = before if self.hidden_before is None else self.hidden_before
            change[m:] = now - (gamma + cutoff) @ before + gamma @ cutoff @ earlier
            gain[m:] = (self.phi[m:, m:] - gamma - cutoff + gamma @ cutoff) @ through
        return gain, change


def four_states():
    """Two outputs that mix four states: a, b, c, Q, R, x0, P0. Outputs hang on states 3 and 0, 1 and 2 are hidden."""
    rng = np.random.default_rng(4)
    a = np.array([[0.9, 0.4, 0.1, 0.0], [-0.2, 0.8, 0.0, 0.3], [0.0, 0.1, 0.7, 0.5], [0.1, 0.3, -0.6, 0.6]])
    c = np.array([[0.2, 0.0, 0.1, 1.5], [2.0, 0.1, 0.0, -0.4]])
    root = 0.1 * rng.normal(size=(4, 4))
    q = root @ root.T + 0.01 * np.eye(4)
    r = np.array([[0.02, 0.005], [0.005, 0.01]])
    return a, np.array([0.5, -0.2, 0.1, 0.3]), c, q, r, np.array([1.0, -1.0, 0.5, 2.0]), np.diag([1.0, 0.2, 0.2, 1.0])


def two_states():
    """Both states measured, mixed: a, b, c, Q, R, x0, P0."""
    a = np.array([[0.95, 0.1], [-0.2, 0.9]])
    c = np.array([[1.0, 0.2], [-0.3, 0.8]])
    r = np.array([[0.02, 0.004], [0.004, 0.01]])
    return a, np.array([0.1, 0.4]), c, np.diag([0.01, 0.02]), r, np.array([1.0, -2.0]), np.diag([1.0, 2.0])


def linear_motion(system, steps: int, seed: int, missing: float = 0.0):
    """Inputs, outputs (some missing) and states of a system's own model."""
    a, b, c, q, r, x, p = system
    rng = np.random.default_rng(seed)
    x = x + np.linalg.cholesky(p) @ rng.normal(size=len(x))
    inputs, outputs, states = rng.normal(size=(steps, 1)), np.zeros((steps, len(c))), np.zeros((steps, len(a)))
    for k in range(steps):
        x = a @ x + b * inputs[k, 0] + np.linalg.cholesky(q) @ rng.normal(size=len(x))
        states[k], outputs[k] = x, c @ x + np.linalg.cholesky(r) @ rng.normal(size=len(c))
    outputs[rng.random(outputs.shape) < missing] = np.nan
    return inputs, outputs, states


def model_of(system):
    return as_model(*system[:3])
