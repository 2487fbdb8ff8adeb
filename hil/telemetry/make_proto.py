"""Generate `servohil.proto` from the Snapshot's FIELDS, and from it the Python classes: `make proto`.

    python -m servohil.hil.telemetry.make_proto

State's integers are sfixed64: every field then has a fixed length, the encoding of a Snapshot is a copy into fixed
places (encoding.py), and the recording keeps each of its bits, a NaN's payload included.
"""

import sys
from importlib import import_module
from pathlib import Path
from typing import Final

from servohil.hil.snapshot import FIELDS

HERE: Final = Path(__file__).resolve().parent
PROTO: Final = HERE / "servohil.proto"
_TYPES: Final = {"<i8": "sfixed64", "<f8": "double"}

_HEAD: Final = """\
// servohil telemetry and recording, version 1. Generated from hil/snapshot.py by hil/telemetry/make_proto.py.
// Units stand in brackets. All times are nanoseconds. A NaN measurement: no valid frame in this cycle.

syntax = "proto3";

package servohil.v1;

// One cycle: the controller's Snapshot, field by field.
message State {
"""

_TAIL: Final = """\
}

// Key `servohil/v1/<rig>/state`, encoding `application/protobuf;servohil.v1.StateBatch`.
message StateBatch {
  uint64 seq = 1;        // counts batches from 1; a jump: this subscriber missed some
  int64 t_unix_ns = 2;   // wall clock at the newest sample's cycle, 0 without a clock (lockstep)
  int64 age_ns = 3;      // from the start of the newest cycle to this message, -1 without a clock
  uint64 lost = 4;       // records that found no room in the ring since the start
  repeated State samples = 15;  // oldest first
}

// Recording, channel `inputs`: what the cycle of the same log_time was told from outside.
message CycleInputs {
  // Little endian: the int64 and float64 words of hil/inputs.py, HEADER_FIELDS, then n_frames CAN frames of 24 bytes:
  // uint32 id, uint8 dlc, uint8 flags (1 extended, 2 remote, 4 error, 8 FD, 16 bit rate switch), uint16 0, int64
  // age_ns, 8 data bytes; all of 80 bytes, with 64 data bytes, where the rig's DBC has a CAN FD message.
  bytes payload = 1;
}

// Recording, channel `checkpoint`: the whole cycle state before the next cycle; bytes belong to one build.
message Checkpoint {
  bytes state = 1;
}
"""


def proto_text() -> str:
    """The .proto file as it must be for the FIELDS of this build. Field number = place in FIELDS, counted from 1."""
    lines = [
        f"  {_TYPES[kind]} {name} = {number};  // [{unit}] {meaning}\n"
        for number, (name, kind, unit, meaning) in enumerate(FIELDS, 1)
    ]
    return _HEAD + "".join(lines) + _TAIL


def main() -> int:
    """Write servohil.proto, servohil_pb2.py and servohil_pb2.pyi beside this file; protoc's exit code."""
    protoc = import_module("grpc_tools.protoc")  # a development tool: not there where the .proto is only read
    PROTO.write_text(proto_text(), encoding="utf-8")
    folder = str(HERE)
    # Run as if from this folder: the path given here becomes the name in every reader's descriptor pool.
    arguments = ["protoc", f"--proto_path={folder}", f"--python_out={folder}", f"--pyi_out={folder}", PROTO.name]
    code = int(protoc.main(arguments))
    stub = HERE / "servohil_pb2.pyi"
    # protoc writes stubs that a strict type check refuses.
    stub.write_text("# mypy: ignore-errors\n" + stub.read_text(encoding="utf-8"), encoding="utf-8")
    return code


if __name__ == "__main__":
    sys.exit(main())
