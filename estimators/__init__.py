"""State estimation for servo-hydraulics: models as plain functions, filters compiled around them."""

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
    "Sensor",
    "SensitivitySRUKF",
    "rts_smooth",
]
