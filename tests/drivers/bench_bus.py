"""What the driver tests share: the bench's DBC and protections for it."""

from pathlib import Path

import numpy as np

from servohil.drivers.codec import Codec, MessageProtection, load_codec
from servohil.drivers.e2e import data_ids
from servohil.drivers.frame import FRAME, STRUCTS

BENCH_DBC = Path(__file__).parents[2] / "rigs" / "bench.dbc"
FD_DBC = BENCH_DBC.with_name("bench-fd.dbc")
SENSOR_MESSAGES = ("Position", "PressureAB", "PressureSupplyTank", "ValveStatus")
COMMAND = "ValveCommand"
POSITION_ID = 0x121
PRESSURE_ID = 0x122
PROTECTIONS = {
    name: MessageProtection(1_000_000, "profile2", data_ids(17 + k))
    for k, name in enumerate((*SENSOR_MESSAGES, COMMAND))
}

FD_PROTECTIONS = {
    name: MessageProtection(1_000_000, "profile5", (0x5E01 + k,)) for k, name in enumerate(("Actuator", COMMAND))
}


def controller_codec() -> Codec:
    return load_codec(BENCH_DBC, PROTECTIONS, SENSOR_MESSAGES, [COMMAND])


def node_codec() -> Codec:
    return load_codec(BENCH_DBC, PROTECTIONS, [COMMAND], SENSOR_MESSAGES)


def frames_of(
    *records: tuple[int, bytes],
    flags: int = 0,
    age_ns: int = 0,
    dlc: int | None = None,
    frame: np.dtype = FRAME,
) -> np.ndarray:
    """A drained batch: (id, data) each."""
    frames = np.zeros(len(records), dtype=frame)
    pack_into, size = STRUCTS[frame.itemsize].pack_into, frame.itemsize
    for k, (can_id, data) in enumerate(records):
        length = len(data) if dlc is None else dlc
        pack_into(frames.view(np.uint8).data, k * size, can_id, length, flags, 0, age_ns, data)
    return frames


def sensors(node: Codec, position_m: float = 0.1, pressure_pa: float = 1e7) -> list[tuple[int, bytes]]:
    return [
        (POSITION_ID, node.encode(node.message_index("Position"), np.array([position_m]))),
        (PRESSURE_ID, node.encode(node.message_index("PressureAB"), np.array([pressure_pa, pressure_pa / 2]))),
    ]


def give(codec: Codec, *records: tuple[int, bytes], now_ns: int = 0, **fields: int) -> int:
    return codec.receive(frames_of(*records, frame=codec.frame, **fields), len(records), now_ns)


def running() -> tuple[Codec, Codec]:
    """A controller and a node that have exchanged two sets of sensor frames."""
    controller, node = controller_codec(), node_codec()
    for now_ns in (1000, 2000):
        give(controller, *sensors(node), now_ns=now_ns)
    return controller, node
