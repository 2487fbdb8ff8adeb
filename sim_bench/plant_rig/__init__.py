"""Any plant behind a CAN node: what is true, what is measured, what may be commanded, and a bench around it."""

from servohil.sim_bench.plant_rig.rig import Channel, PlantRig, PlantRigError

__all__ = ["Channel", "PlantRig", "PlantRigError"]
