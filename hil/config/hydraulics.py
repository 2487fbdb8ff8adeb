"""[cylinder]: what the controller believes of the hydraulics. [plant]: what the simulated actuator node makes true."""

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from servohil.hil.config.section import NonNegative, Positive, Section

if TYPE_CHECKING:
    from servohil.estimators.models.cylinder import CylinderParameters


class Cylinder(Section):
    """[cylinder]: the fields of `CylinderParameters`; leaks, surroundings and load are zero unless given."""

    mass_kg: Positive
    friction_ns_per_m: NonNegative
    area_a_m2: Positive
    area_b_m2: Positive
    dead_volume_a_m3: Positive
    dead_volume_b_m3: Positive
    stroke_m: Positive
    bulk_modulus_pa: Positive
    valve_gain: Positive  # m3/(s V sqrt(Pa))
    leak_internal: NonNegative = 0.0  # m3/(s Pa)
    leak_external_a: NonNegative = 0.0  # m3/(s Pa)
    leak_external_b: NonNegative = 0.0  # m3/(s Pa)
    ambient_pa: float = 0.0
    load_force_n: float = 0.0

    def parameters(self) -> "CylinderParameters":
        """The same as the model's own record."""
        # Here and not above: commands that only read the file need not load numba.
        from servohil.estimators.models.cylinder import CylinderParameters

        return CylinderParameters(**self.model_dump())


class CylinderOverrides(Section):
    """[plant.cylinder]: where the truth differs from [cylinder]."""

    mass_kg: Positive | None = None
    friction_ns_per_m: NonNegative | None = None
    area_a_m2: Positive | None = None
    area_b_m2: Positive | None = None
    dead_volume_a_m3: Positive | None = None
    dead_volume_b_m3: Positive | None = None
    stroke_m: Positive | None = None
    bulk_modulus_pa: Positive | None = None
    valve_gain: Positive | None = None
    leak_internal: NonNegative | None = None
    leak_external_a: NonNegative | None = None
    leak_external_b: NonNegative | None = None
    ambient_pa: float | None = None
    load_force_n: float | None = None


class Imperfections(Section):
    """[plant.imperfections]: what the truth has and the controller's model leaves out; without a key it has not."""

    friction_coulomb_n: NonNegative | None = None
    friction_stribeck_n: NonNegative | None = None  # by which friction at rest exceeds Coulomb's
    stribeck_velocity_m_per_s: Positive | None = None
    rest_velocity_m_per_s: Positive | None = None  # dry friction changes its sign over this width
    dead_band_v: NonNegative | None = None  # overlap of the spool
    spool_order: Literal[0, 1, 2] = 0  # 0: the spool is where the command is
    spool_frequency_rad_per_s: Positive | None = None
    spool_damping: NonNegative | None = None  # of order 2
    supply_resistance: NonNegative | None = None  # Pa s/m3, sag of the supply per flow drawn


class ProcessStd(Section):
    """[plant.process_std]: standard deviation of the noise on the true state, per millisecond."""

    velocity_mps: NonNegative
    pressure_a_pa: NonNegative
    pressure_b_pa: NonNegative


class SensorStd(Section):
    """[plant.sensor_std]: standard deviation of the noise of each sensor, before quantisation."""

    position_m: NonNegative
    pressure_a_pa: NonNegative
    pressure_b_pa: NonNegative
    supply_pa: NonNegative
    tank_pa: NonNegative
    spool_v: NonNegative


class Plant(Section):
    """[plant]: the simulated actuator node only; the controller never reads it."""

    seed: Annotated[int, Field(ge=0)]
    position_m: NonNegative
    pressure_a_pa: float
    pressure_b_pa: float
    supply_pa: float
    tank_pa: float
    command_timeout_s: Positive  # spool to centre after this long without a valid command
    substeps: Annotated[int, Field(ge=1, le=1000)]
    cylinder: CylinderOverrides = CylinderOverrides()
    imperfections: Imperfections = Imperfections()
    process_std: ProcessStd
    sensor_std: SensorStd
