"""What the diagnosis' numbers mean, for people: names of the changes, sizes in SI units, sentences."""

from math import isfinite
from typing import Any, Final, NamedTuple


class ChangeWords(NamedTuple):
    """One change of `estimators.leakage.changes.CHANGES`, in their order; a program that only reads Snapshots need not
    load the compiler for it."""

    name: str
    text: str
    factor: float  # of a unit of the change
    unit: str


CHANGE_WORDS: Final = (
    ChangeWords("internal", "internal leak, A to B", 1e-13, "m3/(s Pa)"),
    ChangeWords("external_a", "external leak, chamber A", 1e-13, "m3/(s Pa)"),
    ChangeWords("external_b", "external leak, chamber B", 1e-13, "m3/(s Pa)"),
    ChangeWords("valve_gain", "valve gain", 1.0, "%"),
    ChangeWords("valve_null", "valve null", 0.01, "V"),
    ChangeWords("bulk_modulus", "bulk modulus (air in the oil)", 1.0, "%"),
    ChangeWords("friction", "viscous friction", 10.0, "N s/m"),
    ChangeWords("dry_friction", "dry friction", 10.0, "N"),
    ChangeWords("load", "load force", 10.0, "N"),
    ChangeWords("supply", "supply pressure beside its reading", 1e5, "Pa"),
    ChangeWords("sensor_a", "pressure sensor A", 1e4, "Pa"),
    ChangeWords("sensor_b", "pressure sensor B", 1e4, "Pa"),
    ChangeWords("overlap", "valve overlap", 0.01, "V"),
)
MODES: Final = ("learning", "calibrating", "watching", "judging")
LEVELS: Final = ("none", "warning", "alarm")
LEAKS: Final = tuple(words.name for words in CHANGE_WORDS[:3])
L_PER_MIN: Final = 6e4  # of a m3/s


def change_name(place: int) -> str | None:
    """Name of a place in CHANGES; "unknown" behind the last, None for -1."""
    if place < 0:
        return None
    return CHANGE_WORDS[place].name if place < len(CHANGE_WORDS) else "unknown"


def verdict_text(row: Any) -> str:
    """The last verdict of a SNAPSHOT row as a sentence."""
    place = int(row["verdict"])
    if place < 0:
        return "nothing has changed"
    if place >= len(CHANGE_WORDS):
        return "something changed that no single cause explains"
    words = CHANGE_WORDS[place]
    size, std = words.factor * float(row["verdict_size"]), words.factor * float(row["verdict_std"])
    return f"{words.text} changed by {size:.3g} +- {std:.1g} {words.unit}"


def leak_text(row: Any) -> str:
    """The largest leak of a SNAPSHOT row as a sentence."""
    kind = int(row["leak_kind"])
    if not 0 <= kind < len(LEAKS):
        return "no leak"
    flow = L_PER_MIN * float(row[f"leak_{LEAKS[kind]}_m3ps"])
    return f"{CHANGE_WORDS[kind].text}: {flow:.2f} l/min above the baseline"


def readable_diagnosis(row: Any) -> dict[str, Any]:
    """The diagnosis in a SNAPSHOT row, for people and shell tools; SI units."""
    place, unclear = int(row["verdict"]), int(row["unclear"])
    words = CHANGE_WORDS[place] if 0 <= place < len(CHANGE_WORDS) else None
    found = None
    if place >= 0:
        found = {
            "change": change_name(place),
            "size": words.factor * float(row["verdict_size"]) if words else None,
            "std": words.factor * float(row["verdict_std"]) if words else None,
            "unit": words.unit if words else None,
            "confidence": _finite(row["verdict_confidence"]),
            "since_cycle": int(row["cycle"]) - int(row["verdict_onset_cycles"]),
        }
    leaks = {
        name: {
            "coefficient": _finite(row[f"leak_{name}"]),
            "std": _finite(row[f"leak_{name}_std"]),
            "flow_m3ps": _finite(row[f"leak_{name}_m3ps"]),
        }
        for name in LEAKS
    }
    level = int(row["leak_alarm"])
    return {
        "cycle": int(row["cycle"]),
        "t_ns": int(row["t_ns"]),
        "mode": _named(MODES, int(row["diagnosis_mode"])),
        "statistic": _finite(row["change_statistic"]),
        "threshold": _finite(row["change_threshold"]),
        "not_excluded": [words.name for i, words in enumerate(CHANGE_WORDS) if unclear >> i & 1],
        "verdicts": int(row["verdicts"]),
        "verdict": found,
        "leak": change_name(int(row["leak_kind"])),
        "level": _named(LEVELS, level),
        "leaks": leaks,
        "residuals_pa": [_finite(row["residual_a_pa"]), _finite(row["residual_b_pa"])],
        "text": leak_text(row) if level else verdict_text(row),
    }


def _named(names: tuple[str, ...], place: int) -> str:
    """A Snapshot of a later version may say what this one has no word for."""
    return names[place] if 0 <= place < len(names) else f"unknown_{place}"


def _finite(value: Any) -> float | None:
    return float(value) if isfinite(value) else None
