"""Conventions about traffic that environments, judging and search share."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

STANDING_SPEED: Final = 0.3  # vehicles slower than this stand [m/s]
ARRIVAL_DISTANCE: Final = 1.0  # an ego whose center is within this distance of its destination has arrived [m]
PASSED_DISTANCE: Final = 5.0  # an ego so far beyond its destination, along its lane, has passed it [m]
TERMINAL: Final = ("collision", "arrived", "passed")  # ends that terminate an episode; all others truncate it
STANDSTILL_TIME: Final = 30.0  # an episode ends when the ego has stood for so long [s]
EPISODE_TIME: Final = 200.0  # an episode takes at most so long, unless the environment is configured otherwise [s]
MOST_ENVS: Final = 4096  # environments in lock-step in a training
MANEUVERS: Final = ("LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER")  # highway-env's meta-actions by index
REAR_END_ANGLE: Final = 0.8  # least angle between the headings at which a contact is no rear-end collision [rad]
EGO_SIZE = (4.70, 2.06)  # length and width [m], Lincoln MKZ
VEHICLE_SIZES: Mapping[str, tuple[float, float]] = MappingProxyType(  # length and width [m]
    {
        "sedan": (4.57, 2.08),
        "suv": (4.71, 2.08),
        "jeep": (4.24, 1.87),
        "hatchback": (4.05, 1.89),
        "school-bus": (9.21, 3.26),
    }
)


def is_rear_end(ahead: float, turned: float, ego_length: float, ego_speed: float, npc_speed: float) -> bool:
    """Return whether a vehicle that touches the ego ran into its back.

    Its center is `ahead` of the ego's along the ego's heading [m], and `turned` is its heading relative to the ego's,
    in [-pi, pi] [rad]. Lengths are in meters, speeds in m/s.
    """
    # A vehicle whose center is ahead of the ego's rear bumper came alongside, not from behind.
    return ahead < -ego_length / 2 and abs(turned) < REAR_END_ANGLE and npc_speed > ego_speed


def wrapped(angle: float) -> float:
    """Return an angle in [-pi, pi] [rad]."""
    return math.remainder(angle, 2 * math.pi)


def with_meta_actions(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a whole configuration of highway-env with meta-actions. If it had them, their target speeds stay."""
    action = config["action"] if config["action"].get("type") == "DiscreteMetaAction" else {}
    meta = {"type": "DiscreteMetaAction", "longitudinal": True, "lateral": True}
    return {**config, "action": {**action, **meta}}
