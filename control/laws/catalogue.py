"""Every law by the name that a rig file calls it."""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from servohil.control.laws import afintsc, fintsc, integral_terminal, intsmc, ntsmc, pid, pole_placement, smc

Step = Callable[..., float]


class Law(NamedTuple):
    """A law: the class of its gains, its compiled step, where in the gains its switching gain lies, if it has one."""

    gains: type[Any]
    step: Step
    switching: int | None


LAWS: Final = {
    "intsmc": Law(intsmc.IntsmcGains, intsmc.intsmc_step, intsmc.SWITCHING),
    "integral_terminal": Law(
        integral_terminal.IntegralTerminalGains, integral_terminal.integral_terminal_step, integral_terminal.SWITCHING
    ),
    "fintsc": Law(fintsc.FintscGains, fintsc.fintsc_step, fintsc.SWITCHING),
    "afintsc": Law(afintsc.AfintscGains, afintsc.afintsc_step, fintsc.SWITCHING),
    "ntsmc": Law(ntsmc.NtsmcGains, ntsmc.ntsmc_step, ntsmc.SWITCHING),
    "smc": Law(smc.SmcGains, smc.smc_step, smc.SWITCHING),
    "pole_placement": Law(pole_placement.PolePlacementGains, pole_placement.pole_placement_step, None),
    "pid": Law(pid.PidGains, pid.pid_step, None),
}
