"""A plant as a rig: its truth, what of it the bus carries, its noise."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servohil.drivers.dbc import SI_FACTORS
from servohil.estimators.model import Model
from servohil.sim_bench.plants.simulate import check_step

Vector = NDArray[np.float64]

COMMAND: Final = "command"  # the message with all inputs
APPLIED: Final = "applied"  # the message with the inputs that were in force over the last period
MAX_INPUTS: Final = 3  # they share one frame, so that none is ever late against another: 16 bits each
MAX_OUTPUTS: Final = 32
TIMEOUT_PERIODS: Final = 3  # one late and one lost command must not stop the plant


class PlantRigError(ValueError):
    """The rig cannot be built or run; the message names the argument, its value and what is allowed.

    Example scenarios: a range that does not contain what the plant starts with, three states but two names, a truth
    whose integration step is too long.
    """


class Channel(NamedTuple):
    """A signal on the bus: the range that it can carry and its unit, both as the DBC file has them.

    A value outside the range cannot be sent: a sensor saturates, a command is refused.
    """

    minimum: float
    maximum: float
    unit: str = ""


@dataclass(frozen=True)
class PlantRig:
    """A simulated plant on a CAN bus.

    Attributes:
        name: of the rig, letters, digits and _.
        truth: the plant, with its parameters; its `dt` is the period of the loop, s.
        x0: (n,) true state at the start.
        inputs: range by name, in the order of the model's u. 0 is what the node falls back to without commands.
        outputs: range by name, in the order of the model's y.
        sensor_std: (m,) standard deviation of the noise of each output, before the bus quantises it.
        process_std: (n,) standard deviation of what is added to the state per period, or one number.
        seed: of both noises.
        command_timeout_s: without a valid command for so long the inputs go to 0.
        interface, channel: of the bus in real time, as in a rig file's [bus].

    Raises:
        PlantRigError, ValueError: see there; a truth whose step is too long is refused by `check_step`.
    """

    name: str
    truth: Model
    x0: Sequence[float]
    inputs: Mapping[str, Channel]
    outputs: Mapping[str, Channel]
    sensor_std: Sequence[float]
    process_std: Sequence[float] | float = 0.0
    seed: int = 1
    command_timeout_s: float = 0.02
    interface: str = "auto"
    channel: str = "vcan0"

    def __post_init__(self) -> None:
        model = self.truth
        if re.fullmatch(r"[A-Za-z_]\w*", self.name) is None:
            raise PlantRigError(f"name = {self.name!r}: must be letters, digits and _")
        if not 1 <= model.n_u <= MAX_INPUTS or model.m > MAX_OUTPUTS:
            raise PlantRigError(
                f"truth has {model.n_u} inputs and {model.m} outputs: 1 to {MAX_INPUTS} and 1 to {MAX_OUTPUTS} "
                "go on the bus"
            )
        for kind, channels, count in (("inputs", self.inputs, model.n_u), ("outputs", self.outputs, model.m)):
            if len(channels) != count:
                raise PlantRigError(f"{kind} = {list(channels)}: the truth has {count}")
            for name, channel in channels.items():
                _check_channel(f"{kind}[{name!r}]", name, channel)
        for name, (low, high, _) in self.inputs.items():
            if not low <= 0.0 <= high:
                raise PlantRigError(f"inputs[{name!r}] = {low} .. {high}: must contain 0, which a silent bus means")
        x0 = self._vector("x0", self.x0, model.n)
        self._noise("sensor_std", self.sensor_std, model.m)
        self._noise("process_std", np.broadcast_to(self.process_std, model.n), model.n)
        least = TIMEOUT_PERIODS * model.dt
        if not (isfinite(self.command_timeout_s) and self.command_timeout_s >= least):
            raise PlantRigError(
                f"command_timeout_s = {self.command_timeout_s!r}: must be at least {TIMEOUT_PERIODS} periods, {least:g}"
            )
        check_step(model, x0, np.zeros(model.n_u))
        start = model.outputs(x0, np.zeros(model.n_u))
        for (name, channel), value in zip(self.outputs.items(), start, strict=True):
            low, high = channel_si(channel)
            if not low <= value <= high:
                raise PlantRigError(f"outputs[{name!r}] = {low} .. {high}: the plant starts at {value:g}")

    def _vector(self, name: str, value: object, size: int) -> Vector:
        vector = np.array(value, dtype=np.float64)
        if vector.shape != (size,) or not np.isfinite(vector).all():
            raise PlantRigError(f"{name} = {value!r}: must be {size} finite numbers")
        return vector

    def _noise(self, name: str, value: object, size: int) -> None:
        if (self._vector(name, value, size) < 0.0).any():
            raise PlantRigError(f"{name} = {value!r}: must be >= 0")

    @property
    def period_ns(self) -> int:
        """Of the loop, ns."""
        return round(self.truth.dt * 1e9)


def channel_si(channel: Channel) -> tuple[float, float]:
    """The range in SI."""
    factor = SI_FACTORS[channel.unit]
    return channel.minimum * factor, channel.maximum * factor


def _check_channel(where: str, name: str, channel: Channel) -> None:
    if re.fullmatch(r"[A-Za-z_]\w*", name) is None or name in (COMMAND, APPLIED):
        raise PlantRigError(f"{where}: must be letters, digits and _, and neither {COMMAND!r} nor {APPLIED!r}")
    if not (isfinite(channel.minimum) and isfinite(channel.maximum) and channel.minimum < channel.maximum):
        raise PlantRigError(f"{where} = {channel.minimum} .. {channel.maximum}: must be finite and rise")
    if channel.unit not in SI_FACTORS:
        raise PlantRigError(f"{where}: unknown unit {channel.unit!r}; known are {', '.join(filter(None, SI_FACTORS))}")
