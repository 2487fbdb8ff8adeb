"""`hil rig FILE.py` and `hil bench FILE.py`: a plant of one's own from its file."""

import importlib.util
import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from servohil.estimators.filter import Filter
from servohil.hil.provenance import provenance
from servohil.sim_bench.plant_rig.bench import bench, bench_realtime, run_plant_node
from servohil.sim_bench.plant_rig.rig import PlantRig, PlantRigError

PICTURE: Final = "bench.png"
Say = Callable[[str], None]


def load_plant(path: Path) -> ModuleType:
    """The module in `path`; it must define `rig`. It is executed: use no file that you would not run.

    Raises:
        PlantRigError: no such file, or no `rig` in it.
    """
    if not path.is_file():
        raise PlantRigError(f"{path}: no such file")
    spec = importlib.util.spec_from_file_location(f"plant_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    _need(path, module, "rig", PlantRig)
    return module


def _need(path: Path, module: ModuleType, name: str, kind: type) -> Any:
    found = getattr(module, name, None)
    if not isinstance(found, kind):
        raise PlantRigError(f"{path}: {name} = {found!r}: must be a {kind.__name__}")
    return found


def plant_rig_command(path: Path, truth_path: Path | None, log_s: float, say: Say) -> None:
    """Run the node of `path` until it is stopped.

    Raises:
        PlantRigError, BusError: see `load_plant` and `run_plant_node`.
    """
    steps = run_plant_node(load_plant(path).rig, truth_path, log_s, say)
    say(f"{steps} steps")


def plant_bench_command(path: Path, duration_s: float, lockstep: bool, folder: Path, json_path: Path | None,
                        say: Say) -> None:  # fmt: skip
    """Close the loop of `path`, say the errors, leave a picture.

    Raises:
        PlantRigError, BusError: what of the file, of the loop or of the bus does not work.
    """
    module = load_plant(path)
    estimator, law = _need(path, module, "estimator", Filter), getattr(module, "law", None)
    if not callable(law):
        raise PlantRigError(f"{path}: law = {law!r}: must be a function of time s and estimate")
    if lockstep:
        run = bench(module.rig, estimator, law, duration_s)
    else:
        run = bench_realtime(path, module.rig, estimator, law, duration_s, folder, say)
    for line in run.lines():
        say(line)
    run.draw(folder / PICTURE)
    say(f"picture      {folder / PICTURE}")
    if json_path is not None:
        errors = dict(zip(run.names, run.rms_error.tolist(), strict=False))
        found = {"provenance": provenance(), "rig": run.rig.name, "periods": len(run.time), "rms_error": errors}
        json_path.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
