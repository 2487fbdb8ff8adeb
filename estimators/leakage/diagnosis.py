"""The leakage diagnosis: what changed in the cylinder, whether it is a leak, which one, how large, and how sure.

A twin of the estimator with its Q and R frozen watches the innovations: adaptation would take a leak for noise. The
statistics are those of a GLR test with Gaussian nuisance over all onsets of the last seconds and all changes that
`changes.py` lists; the method is described in docs/leakage.md.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, log
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.changes import CHANGES, N_CHANGES, N_LEAKS, NAMES
from servohil.estimators.leakage.corrected import change_table
from servohil.estimators.leakage.diagnosis_step import SIGNATURE as STEP
from servohil.estimators.leakage.diagnosis_step import step
from servohil.estimators.leakage.model_update import restart, start
from servohil.estimators.leakage.onsets import MAX_BLOCKS
from servohil.estimators.leakage.signature import SIGNATURE, advance_signatures
from servohil.estimators.model import Model
from servohil.estimators.models import cylinder
from servohil.estimators.srukf import SRUKF

Vector = NDArray[np.float64]

BLOCK_S: Final = 0.032
GUARD_S: Final = 0.25  # after a change: the filter's memory, for which the signatures do not hold
# The largest ratio of an hour without a change exceeds h about this many times exp(-h / 2): Monte Carlo over healthy
# hours with drift, `hil evaluate leakage`.
RATIOS_PER_HOUR: Final = 1e5
HOURS: Final = (0.01, 1e6)  # between false suspicions, that the law above was seen to hold for, or may be taken to
LEAST_FLOW: Final = 0.02 / 6e4  # m3/s: drift of valve and oil between two looks is worth a third of it
LEAST_LEARNING_S: Final = 20.0


class DiagnosisError(ValueError):
    """A setting was refused; the message names it, its value and what can be attained."""


@dataclass(frozen=True)
class DiagnosisSettings:
    """How the diagnosis works.

    Attributes:
        learn_s: s of healthy motion in which baseline and model are learnt; 0: the configuration is the truth.
        settle_s: s of uninterrupted motion before what is seen counts.
        hours_between_false_suspicions: mean time between two "something changed" without a cause.
        judge_s: s from the suspicion to the first verdict.
        give_up_s: s after which a change that no hypothesis explains becomes part of the baseline as "unknown".
        confidence: posterior probability that a verdict needs.
        warn_m3_per_s: flow above the baseline that is a warning.
        alarm_m3_per_s: flow that is an alarm.

    Raises:
        DiagnosisError: out of range.
    """

    learn_s: float = 0.0
    settle_s: float = 2.0
    hours_between_false_suspicions: float = 1000.0
    judge_s: float = 0.5
    give_up_s: float = 60.0
    confidence: float = 0.999
    warn_m3_per_s: float = 0.05 / 6e4
    alarm_m3_per_s: float = 0.3 / 6e4

    def __post_init__(self) -> None:
        least, most = HOURS
        rules = {
            "learn_s": (
                self.learn_s == 0.0 or self.learn_s >= LEAST_LEARNING_S, f"0, or at least {LEAST_LEARNING_S:g}"
            ),
            "settle_s": (self.settle_s >= 0.0, ">= 0"),
            "hours_between_false_suspicions": (
                least <= self.hours_between_false_suspicions <= most, f"{least:g} to {most:g} can be attained"
            ),
            "judge_s": (self.judge_s >= GUARD_S, f">= {GUARD_S:g}, the memory of the filter"),
            "give_up_s": (self.give_up_s > self.judge_s, f"> judge_s = {self.judge_s:g}"),
            "confidence": (0.5 < self.confidence < 1.0, "between 0.5 and 1"),
            "warn_m3_per_s": (
                self.warn_m3_per_s >= LEAST_FLOW, f"at least {LEAST_FLOW:.3g}, the least flow that is told from drift"
            ),
            "alarm_m3_per_s": (
                self.alarm_m3_per_s >= self.warn_m3_per_s, f">= warn_m3_per_s = {self.warn_m3_per_s:.3g}"
            ),
        }  # fmt: skip
        for name, (holds, allowed) in rules.items():
            value = getattr(self, name)
            if not (isfinite(value) and holds):
                raise DiagnosisError(f"{name} = {value!r}: must be {allowed}")

    @property
    def threshold(self) -> float:
        """2 ln Lambda that is a suspicion."""
        return expected_ratio(self.hours_between_false_suspicions)

    def vector(self, dt_s: float) -> Vector:
        """All settings as the compiled step takes them, for a sample period of dt_s."""
        values = np.zeros(at.SETTINGS_SIZE)
        block = max(round(BLOCK_S / dt_s), MAX_BLOCKS + 3)  # a scan takes a cycle per block that is kept
        values[: at.N_NUMBERS] = (
            dt_s, block, round(self.settle_s / dt_s), round(self.learn_s / dt_s), self.threshold,
            round(GUARD_S / dt_s), round(self.judge_s / dt_s), round(self.give_up_s / dt_s), self.confidence,
            self.warn_m3_per_s, self.alarm_m3_per_s, expected_ratio(max(0.3 * self.learn_s / 3600.0, HOURS[0] / 10.0)),
        )  # fmt: skip
        for i, change in enumerate(CHANGES):
            values[at.PRIOR + i] = change.unknown if self.learn_s > 0.0 else change.configured
            values[at.DRIFT + i] = change.drift
            values[at.STEP + i] = change.step
        return values


def expected_ratio(hours: float) -> float:
    """The largest 2 ln Lambda of so many hours without a change, about."""
    return 2.0 * log(RATIOS_PER_HOUR * hours)


@njit(nogil=True, cache=True, error_model="numpy")
def _report(state: Vector, threshold: float, integers: NDArray[np.int64], numbers: Vector) -> None:
    integers[0] = int(state[at.MODE])
    integers[1] = int(state[at.RATIO_CHANGE]) if state[at.RATIO] > 0.0 else N_CHANGES
    integers[2] = int(state[at.UNCLEAR])
    integers[3] = int(state[at.VERDICT])
    integers[4] = int(state[at.VERDICTS])
    integers[5] = int(state[at.CYCLES] - state[at.VERDICT_ONSET]) if state[at.VERDICT_ONSET] >= 0.0 else -1
    integers[6] = int(state[at.LEAK])
    numbers[0] = state[at.RATIO]
    numbers[1] = threshold
    numbers[2] = state[at.VERDICT_SIZE]
    numbers[3] = state[at.VERDICT_STD]
    numbers[4] = state[at.VERDICT_CONFIDENCE]
    for j in range(N_LEAKS):
        numbers[5 + j] = state[at.COEFFICIENT + j]
        numbers[5 + N_LEAKS + j] = state[at.COEFFICIENT_STD + j]
        numbers[5 + 2 * N_LEAKS + j] = state[at.FLOW + j]


class Diagnosis:
    """Diagnosis of one cylinder; everything that changes lives in two arenas.

    Args:
        model: the cylinder as configured.
        Q: (4, 4) process noise per step of the twin, as a filter takes it; what the model leaves out is among the
            changes, so it is the noise of a good model.
        R: (3, 3) measurement noise, diagonal.
        settings: see there.
        arena: float64 array of `arena_size()` to live in, or None.

    Raises:
        DiagnosisError: the model is no cylinder.
        ValueError: Q, R or arena were refused.
    """

    def __init__(
        self, model: Model, Q: ArrayLike, R: ArrayLike, settings: DiagnosisSettings, arena: Vector | None = None
    ) -> None:
        if (model.n, model.m, model.n_u, len(model.p)) != (
            cylinder.N_STATES,
            cylinder.N_OUTPUTS,
            cylinder.N_INPUTS,
            14,
        ):
            raise DiagnosisError(f"model with n = {model.n}, m = {model.m}: must be that of the cylinder")
        arena = np.zeros(self.arena_size()) if arena is None else arena
        if arena.shape != (self.arena_size(),) or arena.dtype != np.float64 or not arena.flags.c_contiguous:
            raise DiagnosisError(
                f"arena = {arena.dtype} {arena.shape}: must be contiguous float64 ({self.arena_size()},)"
            )
        self.settings = settings
        self.arena = arena
        self.state = arena[: at.ARENA_SIZE]
        std = np.array([1e-3, 1e-2, 0.2, 0.2])
        self.twin = SRUKF(model, np.zeros(4), np.diag(std**2), Q, R, arena=arena[at.ARENA_SIZE :])
        self._p = model.p
        self._table = change_table(model.p)
        self._work = np.zeros(at.WORK)
        self._settings = settings.vector(model.dt)
        self._step = model.specialise(
            step, STEP, twin_step=self.twin._step, signature_step=model.specialise(advance_signatures, SIGNATURE)
        )
        start(self.state, self._settings)

    @staticmethod
    def arena_size() -> int:
        """Float64 elements of the arena."""
        return at.ARENA_SIZE + SRUKF.arena_size(cylinder.N_STATES, cylinder.N_OUTPUTS)

    def start(self, y: Vector) -> None:
        """The twin starts anew, at rest where y (position m, pressures A and B MPa) says; what was learnt stays."""
        self.twin.reset(x0=np.array([y[0], 0.0, y[1], y[2]]))
        restart(self.state)

    def step(self, u: Vector, y: Vector, judging: bool) -> int:
        """One cycle; see `diagnosis_step.step`. Returns the status of the twin."""
        return int(
            self._step(
                self.state, self._work, self._settings, self.twin.arena, self.twin._work, self._p, u, y, self._table,
                judging,
            )
        )  # fmt: skip

    def pause(self) -> None:
        """For the memory of the filter nothing counts: something went in that the model cannot know."""
        state, settings = self.state, self._settings
        state[at.SETTLED] = min(state[at.SETTLED], settings[at.SETTLE_STEPS] - settings[at.GUARD_STEPS])

    def acknowledge(self) -> None:
        """The alarm is no longer latched; it stays while the leak is that large."""
        self.state[at.LATCHED] = 0.0

    @property
    def alarm(self) -> int:
        """0 none, 1 warning, 2 alarm; an alarm is latched."""
        return 2 if self.state[at.LATCHED] else int(self.state[at.LEVEL])

    @property
    def pending(self) -> bool:
        """Whether something has changed and is not explained, or not sized, yet."""
        return bool(self.state[at.MODE] == at.PENDING or self.state[at.REFINE_CYCLES] > 0.0)

    @property
    def learning(self) -> bool:
        """Whether the model is not yet what it will be."""
        return bool(self.state[at.MODE] == at.LEARNING)

    @property
    def verdict(self) -> str | None:
        """Name of the last change that was found; "unknown" for one that no single hypothesis explains."""
        found = int(self.state[at.VERDICT])
        return None if found < 0 else (NAMES[found] if found < N_CHANGES else "unknown")

    def report(self, integers: NDArray[np.int64], numbers: Vector) -> None:
        """Fill integers (7,) and numbers (14,): mode, suspect, changes that are not excluded (bits), verdict, count of
        verdicts, cycles since the verdict's onset, largest leak; statistic, threshold, size of the verdict in units
        of its change, its standard deviation, its confidence; of the three leaks above the baseline the coefficients
        m3/(s Pa), their standard deviations and the flows m3/s at the mean pressure difference of now."""
        _report(self.state, float(self._settings[at.THRESHOLD]), integers, numbers)

    @property
    def leaks(self) -> Mapping[str, tuple[float, float]]:
        """Each leak above the baseline: coefficient and standard deviation, m3/(s Pa)."""
        size, std = self.state[at.COEFFICIENT :], self.state[at.COEFFICIENT_STD :]
        return {NAMES[j]: (float(size[j]), float(std[j])) for j in range(N_LEAKS)}
