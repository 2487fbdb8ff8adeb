"""State estimation for servo-hydraulics: models as plain functions, filters compiled around them.

A name is loaded when it is first asked for: a controller with one filter does not wait for the others.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from servohil.estimators.aekf import AEKF
    from servohil.estimators.asrukf import ASRUKF
    from servohil.estimators.aukf import AUKF
    from servohil.estimators.combined_second_order import CombinedSecondOrderFilter
    from servohil.estimators.delayed import DelayedFilter
    from servohil.estimators.ekf import EKF
    from servohil.estimators.joint_srukf import JointSRUKF
    from servohil.estimators.kf import KF
    from servohil.estimators.model import Model
    from servohil.estimators.optimal_second_order import OptimalSecondOrderFilter
    from servohil.estimators.robust_kf import RobustKF
    from servohil.estimators.second_order import SecondOrderFilter
    from servohil.estimators.sensitivity_srukf import SensitivitySRUKF
    from servohil.estimators.sensors import MultiRate, Sensor
    from servohil.estimators.smoother import rts_smooth
    from servohil.estimators.srukf import SRUKF
    from servohil.estimators.svsf import SVSF
    from servohil.estimators.ukf import UKF

# Where each public name lives.
HOMES: Final = {
    "AEKF": "aekf",
    "ASRUKF": "asrukf",
    "AUKF": "aukf",
    "CombinedSecondOrderFilter": "combined_second_order",
    "DelayedFilter": "delayed",
    "EKF": "ekf",
    "JointSRUKF": "joint_srukf",
    "KF": "kf",
    "Model": "model",
    "OptimalSecondOrderFilter": "optimal_second_order",
    "RobustKF": "robust_kf",
    "SecondOrderFilter": "second_order",
    "SensitivitySRUKF": "sensitivity_srukf",
    "MultiRate": "sensors",
    "Sensor": "sensors",
    "rts_smooth": "smoother",
    "SRUKF": "srukf",
    "SVSF": "svsf",
    "UKF": "ukf",
}

__all__ = [
    "AEKF",
    "ASRUKF",
    "AUKF",
    "EKF",
    "KF",
    "SRUKF",
    "SVSF",
    "UKF",
    "CombinedSecondOrderFilter",
    "DelayedFilter",
    "JointSRUKF",
    "Model",
    "MultiRate",
    "OptimalSecondOrderFilter",
    "RobustKF",
    "SecondOrderFilter",
    "SensitivitySRUKF",
    "Sensor",
    "rts_smooth",
]


def __getattr__(name: str) -> Any:
    if name not in HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{HOMES[name]}"), name)
