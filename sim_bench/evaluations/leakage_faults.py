"""What is done to the cylinder in `hil evaluate leakage`: leaks, and what is none."""

from typing import Final, NamedTuple

from servohil.estimators.leakage.changes import N_CHANGES, N_LEAKS, NAMES
from servohil.estimators.models.cylinder import BULK, CS, FRICTION, K_EA, K_EB, K_I, LOAD
from servohil.sim_bench.evaluations.leakage_loop import NULL_V, SENSOR_A_PA, SENSOR_B_PA, SUPPLY_PA
from servohil.sim_bench.plants.cylinder import COULOMB, DEAD_BAND

LEAK_NAMES: Final = NAMES[:N_LEAKS]
LEAK_PARAMETERS: Final = (K_I, K_EA, K_EB)
NOTHING: Final = -1


class Fault(NamedTuple):
    """One thing that happens.

    Attributes:
        group: which claim and table it belongs to.
        name: within the group.
        moves: parameter or one of the others of `leakage_loop`; NOTHING for none.
        amount: L/min of a leak at the pressure difference present; else a share of the parameter, or its SI unit.
        is_right: the verdict that names it, index into CHANGES; -1: none does.
        relative: whether the amount is a share of the configured parameter.
        ramp_s, period_s: how it grows, how it comes and goes.
        noise: factor on the sensors' noise from then on.
        missing: chamber whose pressure sensor is silent from before on, -1 none.
        watch_s: how long at most.
    """

    group: str
    name: str
    moves: int
    amount: float
    is_right: int
    relative: bool = False
    ramp_s: float = 0.0
    period_s: float = 0.0
    noise: float = 1.0
    missing: int = -1
    watch_s: float = 60.0

    @property
    def is_leak(self) -> bool:
        """Whether oil goes where it should not."""
        return self.moves in LEAK_PARAMETERS


STEP_SIZES: Final = (1.0, 0.5, 0.25, 0.1, 0.05, 0.02)  # L/min
ROC_SIZES: Final = (0.02, 0.01, 0.005)
INDEX_SIZES: Final = (1.0, 0.5, 0.25, 0.1)
RAMP_LPM, RAMP_S = 0.5, 60.0
DIFFERENCES: Final = {
    "valve gain +5 %": (CS, 0.05, "valve_gain", True),
    "valve gain -5 %": (CS, -0.05, "valve_gain", True),
    "valve null +0.05 V": (NULL_V, 0.05, "valve_null", False),
    "valve null -0.05 V": (NULL_V, -0.05, "valve_null", False),
    "bulk modulus +10 %": (BULK, 0.1, "bulk_modulus", True),
    "bulk modulus -10 %": (BULK, -0.1, "bulk_modulus", True),
    "friction +20 %": (FRICTION, 0.2, "friction", True),
    "friction -20 %": (FRICTION, -0.2, "friction", True),
    "load +1 kN": (LOAD, 1000.0, "load", False),
    "load -1 kN": (LOAD, -1000.0, "load", False),
    "supply -10 %": (SUPPLY_PA, -1.4e6, "", False),  # measured: to the model it is no change
    "sensor A +1 bar": (SENSOR_A_PA, 1e5, "sensor_a", False),
    "sensor B +1 bar": (SENSOR_B_PA, 1e5, "sensor_b", False),
    "dry friction 100 N": (COULOMB, 100.0, "dry_friction", False),
    "overlap 0.1 V": (DEAD_BAND, 0.1, "overlap", False),
}


def leak(group: str, kind: int, lpm: float, **how: float) -> Fault:
    """A leak of that many L/min."""
    return Fault(group, f"{LEAK_NAMES[kind]} {lpm:g}", LEAK_PARAMETERS[kind], lpm, kind, **how)  # type: ignore[arg-type]


def _each(group: str, lpm: float, **how: float) -> list[Fault]:
    return [leak(group, kind, lpm, **how) for kind in range(N_LEAKS)]


SILENT: Final = ("missing A", "missing B")  # pressure sensor


def main_faults() -> list[Fault]:
    """All that happens to every commissioned cylinder."""
    found = [leak("step", kind, lpm) for lpm in STEP_SIZES for kind in range(N_LEAKS)]
    for name, (moves, amount, verdict, relative) in DIFFERENCES.items():
        right = NAMES.index(verdict) if verdict else -1
        found.append(Fault("other", name, moves, amount, right, relative, watch_s=30.0))
    return found


def more_faults() -> list[Fault]:
    """What happens to some of them besides: other onsets, more noise, a sensor less."""
    found = _each("ramp", RAMP_LPM, ramp_s=RAMP_S, watch_s=75.0)
    found += _each("intermittent", 0.5, period_s=4.0, watch_s=30.0)
    found += [Fault("noise", "none", NOTHING, 0.0, -1, noise=3.0, watch_s=30.0), *_each("noise", 0.25, noise=3.0)]
    for chamber, group in enumerate(SILENT):
        found += [Fault(group, "none", NOTHING, 0.0, -1, missing=chamber, watch_s=20.0)]
        found += _each(group, 0.25, missing=chamber, watch_s=30.0)
    return found


def silent_faults() -> list[Fault]:
    """What is no leak while one pressure sensor is silent."""
    faults = [fault for fault in main_faults() if fault.group == "other"]
    return [fault._replace(group=group, missing=i) for i, group in enumerate(SILENT) for fault in faults]


def roc_faults() -> list[Fault]:
    """Leaks so small that they are found or not."""
    return [leak("roc", kind, lpm) for lpm in ROC_SIZES for kind in range(N_LEAKS)]


def index_faults(group: str) -> list[Fault]:
    """Leaks that P2's switching index is asked for."""
    return [leak(group, kind, lpm) for lpm in INDEX_SIZES for kind in range(N_LEAKS)]


# Truths that the model cannot say, and other motions: (parameters of the plant, motion); leaks of 0.25 L/min in each.
SETTINGS: Final[dict[str, tuple[dict[str, float], tuple[float, float] | None]]] = {
    "motion 0.05 m": ({}, (0.05, 2.0)),
    "motion 4 rad/s": ({}, (0.15, 4.0)),
    "dry friction 200 N": ({"friction_coulomb_n": 200.0, "rest_velocity_m_per_s": 5e-3}, None),
    "Stribeck 300 + 100 N": ({"friction_coulomb_n": 300.0, "friction_stribeck_n": 100.0}, None),
    "overlap 0.1 V": ({"dead_band_v": 0.1}, None),
    "supply sags 1e9 Pa s/m3": ({"supply_resistance": 1e9}, None),
    "mass 300 kg": ({"mass_kg": 300.0}, None),
    "dead volume A 0.25 l": ({"dead_volume_a_m3": 2.5e-4}, None),
}


def setting_faults(name: str) -> list[Fault]:
    """What happens to a cylinder of SETTINGS."""
    nothing = Fault(f"setting {name}", "none", NOTHING, 0.0, -1, watch_s=30.0)
    return [nothing, *_each(f"setting {name}", 0.25, watch_s=30.0)]


def verdict_name(verdict: int) -> str:
    """As in the Diagnosis."""
    return NAMES[verdict] if 0 <= verdict < N_CHANGES else "unknown"
