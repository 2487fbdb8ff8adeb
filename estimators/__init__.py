"""State estimation for servo-hydraulics: models as plain functions, filters compiled around them."""

from servohil.estimators.asrukf import ASRUKF
from servohil.estimators.model import Model
from servohil.estimators.srukf import SRUKF

__all__ = ["ASRUKF", "SRUKF", "Model"]
