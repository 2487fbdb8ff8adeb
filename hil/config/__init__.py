"""The rig's configuration: one TOML file, validated at start-up, frozen afterwards.

pydantic is loaded with this package, so only start-up code imports it; the loop is given plain numbers.
"""

from servohil.hil.config.load import ConfigError, load_rig
from servohil.hil.config.rig import Rig

__all__ = ["ConfigError", "Rig", "load_rig"]
