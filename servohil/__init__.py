"""servohil: an open real-time hardware-in-the-loop controller stack for servo-hydraulic actuators.

The rooms of the project live at the repository root and are imported from here: `servohil.estimators`,
`servohil.control`, `servohil.drivers`, `servohil.hil`, `servohil.sim_bench`.
"""

from servohil._compiled_cache import use_cache_of_these_sources

__version__ = "0.1.0"

use_cache_of_these_sources()
