"""A [control] table for every law, with one bandwidth: four poles, or what comes nearest, at 80 rad/s on the bench.

The sliding laws have one switching gain, 800 m/s3: more than what a valve gain that is wrong by 20 % asks for. Their
boundary layers put the pole inside the layer at the same 80 rad/s. mu and the layer of the synergetic laws were
chosen by trial, as their poles move with S. PID knows no model and cannot have this bandwidth, as the load swings on
its oil at 75 rad/s: twice its proportional gain makes it oscillate. Its gains were chosen by trial for the smallest
error.
"""

from typing import Any, Final

POLE_PER_S: Final = 80.0
SWITCHING: Final = 800.0
C: Final = [120.0, 13440.0, 768000.0]  # c1 r^2 + (1 + c2) r + c3: 80 rad/s, damping 0.7

LAW_TABLES: Final[dict[str, dict[str, Any]]] = {
    "intsmc": {
        "law": "intsmc", "alpha1": 1.01, "c": C, "decay_per_s": POLE_PER_S, "switching_gain": SWITCHING,
        "boundary_layer": 1200.0, "singularity_bound": 0.97,
    },
    "integral_terminal": {
        "law": "integral_terminal", "alpha": 0.95, "c": [240.0, 19200.0, 512000.0], "switching_gain": SWITCHING,
        "boundary_layer": 10.0,
    },
    "fintsc": {
        "law": "fintsc", "mu": 0.003, "alpha1": 1.01, "power": 1.2, "c": C, "switching_gain": SWITCHING,
        "boundary_layer": 50.0, "epsilon": 1.0, "singularity_bound": 0.97,
    },
    "afintsc": {
        "law": "afintsc", "fuzzy": "type2", "error_scale_m": 1e-3, "rate_scale_mps": 0.02, "footprint": 0.1,
        "gamma": 0.006, "alpha1": 1.01, "power": 1.2, "c": C, "switching_gain": SWITCHING, "boundary_layer": 50.0,
        "epsilon": 1.0, "singularity_bound": 0.97,
    },
    "ntsmc": {
        "law": "ntsmc", "beta": [40.0, 6400.0], "power": [1.05, 1.05], "switching_gain": SWITCHING,
        "boundary_layer": 1.5e-3, "singularity_bound": 0.9,
    },
    "smc": {"law": "smc", "decay_per_s": POLE_PER_S, "switching_gain": SWITCHING, "boundary_layer": 10.0},
    "pole_placement": {"law": "pole_placement", "pole_per_s": POLE_PER_S, "integral": True},
    "pid": {
        "law": "pid", "proportional": 150.0, "integral": 5000.0, "derivative": 0.0, "velocity_feedforward": 11.0,
    },
}  # fmt: skip
