"""What telemetry says about itself: descriptors for any language, meanings and units, names of states."""

from functools import cache
from pathlib import Path
from typing import Any, Final

from google.protobuf import descriptor_pb2

from servohil.hil.gate import DeviceState
from servohil.hil.snapshot import FIELDS, SNAPSHOT_VERSION
from servohil.hil.telemetry import servohil_pb2

PROTO_PATH: Final = Path(__file__).resolve().parent / "servohil.proto"
STATE_NAMES: Final = {int(state): state.name for state in DeviceState}
FAULT_STATES: Final = frozenset({DeviceState.FAULT_REACTION, DeviceState.FAULT_HOLD, DeviceState.FAULT_DISABLED})


@cache
def descriptor_set() -> bytes:
    """A serialised FileDescriptorSet with all messages: enough to decode without our code, in any language."""
    described = descriptor_pb2.FileDescriptorSet()
    servohil_pb2.DESCRIPTOR.CopyToProto(described.file.add())
    data: bytes = described.SerializeToString()
    return data


def proto_text() -> str:
    """The .proto source, with units and meanings as comments."""
    return PROTO_PATH.read_text(encoding="utf-8")


def state_name(state: int) -> str:
    """CiA 408 name of a device state."""
    return STATE_NAMES.get(state, f"UNKNOWN_{state}")


def field_facts() -> dict[str, dict[str, Any]]:
    """name -> {unit, type, meaning, number}; number is the field number in `State`."""
    kinds = {"<i8": "int64", "<f8": "double"}
    return {
        name: {"unit": unit, "type": kinds[kind], "meaning": meaning, "number": number}
        for number, (name, kind, unit, meaning) in enumerate(FIELDS, 1)
    }


def meta(rig: str, endpoint: str, batch_ns: int, facts: dict[str, str]) -> dict[str, Any]:
    """The `meta` document. `facts`: versions, config hash, git revision, as the controller gave them."""
    return {
        "rig": rig,
        "endpoint": endpoint,
        "batch_ns": batch_ns,
        "snapshot_version": SNAPSHOT_VERSION,
        "states": STATE_NAMES,
        "fields": field_facts(),
        **facts,
    }
