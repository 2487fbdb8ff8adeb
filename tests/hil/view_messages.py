"""What a rig says, made up: messages as they come out of Zenoh."""

import json
from typing import Any

import numpy as np

from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry.encoding import encode_batch, encode_samples
from servohil.hil.view.rig_link import Message

MS = 1_000_000


def batch(first_cycle: int, n: int, seq: int, at_ns: int, age_ns: int = 0, **values: Any) -> Message:
    """`state` with cycles of 1 ms that all hold `values`."""
    rows = np.zeros(n, SNAPSHOT)
    rows["cycle"] = first_cycle + np.arange(n)
    rows["t_ns"] = rows["cycle"] * MS
    rows["state"], rows["verdict"], rows["leak_kind"] = 3, -1, -1
    for name, value in values.items():
        rows[name] = value
    return Message("state", encode_batch(encode_samples(rows.tobytes()), seq, 0, age_ns, 0), at_ns)


def said(name: str, content: Any, at_ns: int = 0) -> Message:
    """Anything in JSON."""
    return Message(name, json.dumps(content).encode(), at_ns)
