"""What a changed controller concludes from recorded inputs, as lines and as a figure."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from servohil.hil.config.problems import shown
from servohil.hil.gate import DeviceState
from servohil.hil.snapshot import FIELDS
from servohil.hil.what_if import WhatIf

UNITS: Final = {name: unit for name, _, unit, _ in FIELDS}
ROWS: Final = 15
PANELS: Final = 5
FORMATS: Final = (".png", ".svg", ".pdf")


def what_if_lines(result: WhatIf, changes: Mapping[str, Any]) -> list[str]:
    """The differences in words, the largest first."""
    changed = ", ".join(f"{key} = {shown(value)}" for key, value in changes.items())
    lines = [f"{result.cycles} recorded cycles with {changed}"]
    lines.append("open loop: the recorded measurements stay; nothing on the bus follows the changed command")
    if result.lost:
        lines.append(f"{result.lost} cycles are missing in the recording: the changed controller did not see them")
    alarms = [f"at {alarm:.3f} s" if alarm is not None else "never" for alarm in result.alarm_s]
    states = [DeviceState(int(row["state"])).name for row in result.last]
    lines += [
        f"leak alarm   recorded {alarms[0]}, now {alarms[1]}",
        f"last state   recorded {states[0]}, now {states[1]}",
    ]
    ranked = result.ranked()
    if not ranked:
        return [*lines, "no field of any Snapshot differs"]
    lines.append(f"{'field':<30}{'unit':<11}{'largest':>12}{'at':>10}{'rms':>12}   differs in")
    for name, found in ranked[:ROWS]:
        part = f"{100.0 * found.cycles / result.cycles:.0f} % of cycles"
        lines.append(
            f"{name:<30}{UNITS[name]:<11}{found.largest:>12.4g}{found.at_s:>8.3f} s{found.rms:>12.4g}   {part}"
        )
    if len(ranked) > ROWS:
        lines.append(f"and {len(ranked) - ROWS} fields that differ less")
    return lines


def check_figure(path: Path) -> None:
    """Raises ValueError for a file that no figure can be written to."""
    if path.suffix.lower() not in FORMATS:
        raise ValueError(f"--figure {path}: allowed: a name that ends in {', '.join(FORMATS)}")


def draw_what_if(result: WhatIf, changes: Mapping[str, Any], path: Path) -> None:
    """The fields that differ most, recorded and changed, over time."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    rows = result.rows
    time_s = rows["t_ns"][:, 0] * 1e-9
    numbers = {name for name, kind, _, _ in FIELDS if kind == "<f8"}
    names = [name for name, _ in result.ranked() if name in numbers][:PANELS] or ["est_position_m"]
    figure, axes = plt.subplots(
        len(names), 1, sharex=True, squeeze=False, figsize=(9, 1.2 + 1.7 * len(names)), layout="constrained"
    )
    for axis, name in zip(axes[:, 0], names, strict=True):
        axis.plot(time_s, rows[name][:, 0], color="#52525b", linewidth=1.0, label="recorded")
        axis.plot(time_s, rows[name][:, 1], color="#c2410c", linewidth=1.0, label="changed")
        axis.set_title(f"{name}, {UNITS[name]}", loc="left", fontsize="medium")
        axis.grid(alpha=0.3)
    axes[0, 0].legend(loc="upper right", ncols=2, frameon=False)
    axes[-1, 0].set_xlabel("time, s")
    figure.suptitle(
        ", ".join(f"{key} = {shown(value)}" for key, value in changes.items()) + " (open loop)", fontsize="medium"
    )
    figure.savefig(path, dpi=130)
    plt.close(figure)
