"""The configuration as it is really used: overrides of the command line applied, written beside the results as TOML."""

from pathlib import Path
from typing import Any, Final

import tomli_w

from servohil.hil.config.load import load_rig
from servohil.hil.config.rig import Rig

RIG_FILE: Final = "rig.toml"


def effective_tables(rig: Rig, rate_hz: float | None = None, seed: int | None = None) -> dict[str, Any]:
    """The rig as plain tables, a trajectory's samples among them.

    Args:
        rig: as loaded.
        rate_hz: a rate instead of the rig's; the period of every message scales with it.
        seed: one instead of the plant's.
    """
    tables: dict[str, Any] = rig.self_contained.model_dump(mode="json", exclude_none=True)
    if rig.credentials_path is not None:  # these tables will stand in another folder
        tables["telemetry"]["credentials"] = str(rig.credentials_path.absolute())
    if rate_hz is not None:
        ratio = rig.loop.rate_hz / rate_hz
        tables["loop"]["rate_hz"] = rate_hz
        for message in tables["bus"]["messages"].values():
            message["period_s"] *= ratio
    if seed is not None and "plant" in tables:
        tables["plant"]["seed"] = seed
    return tables


def write_effective(rig: Rig, folder: Path, rate_hz: float | None = None, seed: int | None = None) -> Rig:
    """Write `rig.toml` and its DBC into `folder` and load them from there: what runs is what stands in the folder.

    Raises:
        ConfigError: the overrides break a rule.
    """
    tables = effective_tables(rig, rate_hz, seed)
    tables["bus"]["dbc"] = rig.dbc_path.name
    (folder / rig.dbc_path.name).write_bytes(rig.dbc_path.read_bytes())
    path = folder / RIG_FILE
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")
    return load_rig(path)
