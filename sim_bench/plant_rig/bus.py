"""The bus of a plant rig: a DBC file made from its ranges, protected frames, a codec for either end.

One frame carries all inputs, one says which inputs were in force, one each carries an output; all of 8 bytes, every
period, with AUTOSAR E2E profile 2.
"""

import tempfile
from pathlib import Path
from typing import Final

from servohil.drivers import dbc_writer
from servohil.drivers.codec import PROFILE2, Codec, MessageProtection, load_codec
from servohil.drivers.dbc_writer import NewMessage, NewSignal
from servohil.drivers.e2e import data_ids
from servohil.sim_bench.plant_rig.rig import APPLIED, COMMAND, PlantRig

COMMAND_ID: Final = 0x0A0
APPLIED_ID: Final = 0x120
FIRST_OUTPUT_ID: Final = 0x121
NS_PER_MS: Final = 1_000_000


def write_dbc(rig: PlantRig, path: Path) -> None:
    """Describe the rig's bus in a DBC file."""
    inputs = [NewSignal(name, *channel) for name, channel in rig.inputs.items()]
    messages = [
        NewMessage(COMMAND, COMMAND_ID, "Controller", "Node", inputs),
        NewMessage(APPLIED, APPLIED_ID, "Node", "Controller", inputs),
    ]
    for i, (name, channel) in enumerate(rig.outputs.items()):
        messages.append(NewMessage(name, FIRST_OUTPUT_ID + i, "Node", "Controller", [NewSignal(name, *channel)]))
    dbc_writer.write_dbc(path, rig.name, messages, max(1, round(rig.period_ns / NS_PER_MS)))


def plant_codec(rig: PlantRig, *, node: bool) -> Codec:
    """The codec of the node's end, or of the controller's.

    Raises:
        DbcError: a channel cannot be described; the message names it.
    """
    names = (COMMAND, APPLIED, *rig.outputs)
    protections = {
        name: MessageProtection(rig.period_ns, PROFILE2, data_ids(base)) for base, name in enumerate(names, start=17)
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{rig.name}.dbc"
        write_dbc(rig, path)
        ours, theirs = [COMMAND], list(names[1:])
        return load_codec(path, protections, *((ours, theirs) if node else (theirs, ours)))
