"""From a rig's configuration to the parts of its cycle: codec, filter, law, monitor. Everything compiled happens
here.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.control.references import Profile
from servohil.drivers.codec import Codec, DbcError, MessageProtection, load_codec
from servohil.drivers.dbc import load_messages
from servohil.estimators import ASRUKF, SRUKF, Model
from servohil.estimators.leakage.diagnosis import Diagnosis, DiagnosisSettings
from servohil.estimators.leakage.residual_monitor import ResidualMonitor
from servohil.estimators.models import cylinder
from servohil.hil.config import Rig
from servohil.hil.config.controller import MeasurementNoise, ProcessNoise, TwinNoise
from servohil.hil.events import Bounds
from servohil.hil.reference_profile import checked_profile

NS_PER_S: Final = 1_000_000_000
NOISE_PERIOD_S: Final = 1e-3  # process noise is configured per millisecond, whatever the rate
LONGEST_MODEL_STEP_S: Final = 2e-3  # the hydraulic resonance (about 12 Hz) stays well resolved by RK4
PA_PER_MPA: Final = 1e6

SENSOR_SIGNALS: Final = ("position", "pressure_a", "pressure_b", "supply", "tank", "spool")


def load_bus_codec(rig: Rig, receive: Sequence[str], transmit: Sequence[str]) -> Codec:
    """The codec of one end of the rig's bus, protections as configured. Raises DbcError."""
    return load_codec(rig.dbc_path, _protections(rig), receive=list(receive), transmit=list(transmit))


def _protections(rig: Rig) -> dict[str, MessageProtection]:
    return {
        name: MessageProtection(message.period_ns, message.e2e, message.all_data_ids)
        for name, message in rig.bus.messages.items()
    }


def check(rig: Rig) -> None:
    """Look for what the rig file alone does not show, before anything is compiled for it or written.

    Raises:
        DbcError: names the DBC, the message or signal, and what is allowed.
        GainError, ProfileError: name the condition that gains or reference break.
        DiagnosisError: names the setting and what can be attained.
    """
    rig.control.gains()
    build_profile(rig)
    diagnosis_settings(rig)
    names = [*sensor_messages(rig), command_message(rig)]
    tables = {table.name: table for table in load_messages(rig.dbc_path, _protections(rig), names)}
    for path in rig.signals.model_dump().values():
        message, signal = path.split(".", maxsplit=1)
        present = [entry.name for entry in tables[message].signals]
        if signal not in present:
            raise DbcError(
                f'{rig.dbc_path}: no signal "{signal}" in message "{message}"; there is {", ".join(present)}'
            )


def message_of(signal_path: str) -> str:
    """ "Message.signal" -> "Message"."""
    return signal_path.split(".", maxsplit=1)[0]


def sensor_messages(rig: Rig) -> list[str]:
    """Names of the messages that the node sends, in a fixed order."""
    paths = [getattr(rig.signals, name) for name in (*SENSOR_SIGNALS, "status_word")]
    return sorted({message_of(path) for path in paths})


def command_message(rig: Rig) -> str:
    """Name of the message that the controller sends."""
    return message_of(rig.signals.command)


def process_covariance(rig: Rig, std: ProcessNoise | TwinNoise) -> NDArray[np.float64]:
    """Q per cycle in the filter's units (m, m/s, MPa, MPa), from standard deviations per millisecond."""
    per_ms = np.array(
        [std.position_m, std.velocity_mps, std.pressure_a_pa / PA_PER_MPA, std.pressure_b_pa / PA_PER_MPA]
    )
    return np.diag(per_ms**2) * (rig.loop.period_ns / NS_PER_S / NOISE_PERIOD_S)


def measurement_covariance(std: MeasurementNoise) -> NDArray[np.float64]:
    """R in the filter's units (m, MPa, MPa)."""
    return np.diag(np.square([std.position_m, std.pressure_a_pa / PA_PER_MPA, std.pressure_b_pa / PA_PER_MPA]))


def build_model(rig: Rig) -> Model:
    """The estimator's process model: the rig's cylinder at the rig's rate."""
    dt = rig.loop.period_ns / NS_PER_S
    return Model(
        cylinder.f,
        cylinder.h,
        n=cylinder.N_STATES,
        m=cylinder.N_OUTPUTS,
        p=rig.cylinder.parameters().vector(),
        dt=dt,
        integrator="rk4",
        substeps=max(1, round(dt / LONGEST_MODEL_STEP_S)),
        n_u=cylinder.N_INPUTS,
        names=cylinder.STATE_NAMES,
        units=cylinder.STATE_UNITS,
    )


def filter_sizes(rig: Rig) -> dict[str, int]:
    """Float64 words of the arenas of `build_filter` and `build_diagnosis`."""
    n, m = cylinder.N_STATES, cylinder.N_OUTPUTS
    size = SRUKF.arena_size(n, m) if rig.estimator.filter == "srukf" else ASRUKF.arena_size(n, m)
    return {"filter": size, "diagnosis": Diagnosis.arena_size()}


def build_filter(rig: Rig, arena: NDArray[np.float64]) -> SRUKF | ASRUKF:
    """The filter whose estimate the law uses, living in `arena`: its Q and R as configured, or started from there."""
    if rig.estimator.filter == "srukf":
        return SRUKF(build_model(rig), arena=arena, **_filter_start(rig))
    return ASRUKF(build_model(rig), arena=arena, **_filter_start(rig))


def diagnosis_settings(rig: Rig) -> DiagnosisSettings:
    """The diagnosis' own settings. Raises DiagnosisError."""
    leakage = rig.leakage
    return DiagnosisSettings(
        leakage.learn_s, leakage.settle_s, leakage.hours_between_false_suspicions, leakage.judge_s, leakage.give_up_s,
        leakage.confidence, leakage.warn_m3_per_s, leakage.alarm_m3_per_s,
    )  # fmt: skip


def build_diagnosis(rig: Rig, arena: NDArray[np.float64]) -> Diagnosis:
    """The leakage diagnosis with a filter of its own, living in `arena`. Raises DiagnosisError."""
    measured = rig.leakage.measurement_std or rig.estimator.measurement_std
    return Diagnosis(
        build_model(rig), process_covariance(rig, rig.leakage.process_std), measurement_covariance(measured),
        diagnosis_settings(rig), arena,
    )  # fmt: skip


def _filter_start(rig: Rig) -> dict[str, Any]:
    estimator = rig.estimator
    initial, measured = estimator.initial_std, estimator.measurement_std
    p0 = [
        initial.position_m,
        initial.velocity_mps,
        initial.pressure_a_pa / PA_PER_MPA,
        initial.pressure_b_pa / PA_PER_MPA,
    ]
    return {
        "x0": np.zeros(cylinder.N_STATES),
        "P0": np.diag(np.square(p0)),
        "Q": process_covariance(rig, estimator.process_std),
        "R": measurement_covariance(measured),
        "alpha": estimator.alpha,
        "beta": estimator.beta,
        "kappa": estimator.kappa,
    }


def build_profile(rig: Rig) -> Profile:
    """The reference profile, checked against the rig's limits. Raises ProfileError, TrajectoryFileError."""
    return checked_profile(rig.reference, rig.path.parent, rig.limits)


def build_monitor(rig: Rig, arena: NDArray[np.float64]) -> ResidualMonitor:
    """The test of the residuals that P1 has, living in `arena`."""
    leakage = rig.leakage
    return ResidualMonitor(
        rig.loop.period_ns / NS_PER_S,
        leakage.threshold_sigma,
        leakage.cusum_drift,
        leakage.cusum_threshold,
        leakage.settle_s,
        arena=arena,
    )


def build_bounds(rig: Rig) -> Bounds:
    """The limits that the cycle judges measurements and estimates by."""
    limits = rig.limits
    return Bounds(
        limits.position_min_m,
        limits.position_max_m,
        limits.speed_max_mps,
        limits.pressure_min_pa,
        limits.pressure_max_pa,
        limits.supply_min_pa,
        limits.sensor_age_periods * rig.loop.period_ns,
        limits.bad_frames_tolerated,
    )
