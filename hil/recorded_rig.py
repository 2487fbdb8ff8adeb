"""The controller that a recording describes, as it was or with other settings: its files, unpacked and loaded."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import tomli_w

from servohil.hil.config import ConfigError, Rig, load_rig
from servohil.hil.config.effective import RIG_FILE, effective_tables
from servohil.hil.config.problems import shown
from servohil.hil.cycle import Cycle
from servohil.hil.recording.layout import RIG_DBC, RIG_TOML, RecordingError
from servohil.hil.recording.reader import Recording

# What shapes outputs from given inputs. The rest says which inputs came, or where results go.
CHANGEABLE: Final = ("cylinder", "estimator", "control", "reference", "limits", "leakage", "signals")


def unpack(recording: Recording, folder: Path) -> Path:
    """Write the recorded rig and DBC into `folder`; the path of the rig. Raises RecordingError without them."""
    missing = [name for name in (RIG_TOML, RIG_DBC) if name not in recording.attachments]
    if missing:
        raise RecordingError(f"{recording.path} carries no {', '.join(missing)}: it cannot be replayed")
    dbc = folder / Path(recording.metadata.get("dbc_name", RIG_DBC)).name  # a name from a file: never a path
    dbc.write_bytes(recording.attachments[RIG_DBC])
    toml = folder / RIG_FILE
    toml.write_bytes(recording.attachments[RIG_TOML])
    return toml


def recorded_controller(recording: Recording, folder: Path, changes: Mapping[str, Any] | None = None) -> Cycle:
    """The controller as it was configured, apart from `changes` (dotted key -> value), its files in `folder`.

    Raises:
        RecordingError: the recording carries no configuration.
        ConfigError, DbcError: this build refuses the recorded configuration, or a change.
    """
    toml = unpack(recording, folder)
    try:
        rig = load_rig(toml)
        if changes:
            rig = changed_rig(rig, changes)
    except ConfigError as error:  # the folder is ours and soon gone
        raise ConfigError(str(error).replace(str(toml), f"{recording.path}, {RIG_FILE}")) from None
    return Cycle(rig, listen_only=recording.metadata.get("listen_only") == "True")


def parse_settings(texts: Sequence[str]) -> dict[str, Any]:
    """`KEY=VALUE` texts as dotted key -> value, the value as in a rig file; what is no TOML is a text.

    Raises ConfigError naming the setting that is none, or that a replay cannot change.
    """
    changes: dict[str, Any] = {}
    for text in texts:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not key or not value:
            raise ConfigError(f"--set {text}: must be KEY=VALUE, such as limits.speed_max_mps=0.5")
        table, _, rest = key.partition(".")
        if table not in CHANGEABLE or not rest:
            allowed = ", ".join(f"{name}.*" for name in CHANGEABLE)
            raise ConfigError(
                f"--set {text}: {key} does not change what is made of recorded inputs; allowed: {allowed}"
            )
        try:
            changes[key] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            changes[key] = value
    return changes


def changed_rig(rig: Rig, changes: Mapping[str, Any]) -> Rig:
    """`rig` with `changes`, written over its file and loaded from there. Raises ConfigError for what is refused."""
    tables = effective_tables(rig)
    for key, value in changes.items():
        *path, last = key.split(".")
        node: Any = tables
        for depth, part in enumerate(path):
            node = node.setdefault(part, {})
            if not isinstance(node, dict):
                place = ".".join(path[: depth + 1])
                raise ConfigError(f"--set {key}={shown(value)}: {place} is no table; allowed: a key of a table")
        node[last] = value
    tables["bus"]["dbc"] = rig.dbc_path.name
    rig.path.write_text(tomli_w.dumps(tables), encoding="utf-8")
    return load_rig(rig.path)
