"""The Intelligent Driver Model, a weak reference: follows its route and the vehicle ahead, ignores other vehicles.

Source: M. Treiber, A. Hennecke, D. Helbing: Congested traffic states in empirical observations and microscopic
simulations, Physical Review E 62 (2000), equations 1 and 2; with the constants of highway-env's `IDMVehicle`.
"""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from behavexplor.ads.road.path import Path, ego_path, limit_at, pose_on_path, project_on_path, steer
from behavexplor.ads.scene_io import ACCELERATION_RANGE, ACTION, OBSERVATION, as_actions, as_scenes
from behavexplor.data.array_types import Bools, Floats
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scene import EGO, HEADING, LENGTH, PRESENT, SPEED, WIDTH, X, Y
from behavexplor.errors import InputError
from behavexplor.jit import kernel_in_place, kernel_inner

ACCELERATION: Final = 3.0  # a, acceleration on a free road [m/s2]
BRAKING: Final = 5.0  # b, comfortable deceleration [m/s2]
JAM_GAP: Final = 5.0  # s0, gap at standstill [m]
TIME_GAP: Final = 1.5  # T, time gap to the vehicle ahead [s]
EXPONENT: Final = 4.0  # delta, exponent of the speed
PERIOD: Final = 0.1  # time between decisions [s]
OVERLAP: Final = 0.5  # a vehicle that reaches less far into the ego's lane is not in it [m]
SAME_WAY: Final = math.pi / 4  # greatest angle to the route of a vehicle that drives along it [rad]


class IDMDriver:
    """A driver that follows the center line of its route at the speed given by the Intelligent Driver Model."""

    observation: Mapping[str, Any] = OBSERVATION  # `{"type": "Scene"}`, see `behavexplor.data.scene`
    action: Mapping[str, Any] = ACTION  # acceleration and steering, each in [-1, 1] over its range
    policy_frequency: int = round(1 / PERIOD)  # decisions per second, 10 Hz
    vectorized: bool = True

    def __init__(self, roadmap: RoadMap) -> None:
        self._path = ego_path(roadmap)

    def predict(
        self,
        observation: Floats,
        state: Any = None,
        episode_start: Bools | None = None,  # noqa: ARG002
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Floats, Any]:
        """Decide for a batch of egos; see `behavexplor.ads.interface.ADS`.

        Observations are scenes, shape (B, 1 + n, 8), see `behavexplor.data.scene`. The state is returned unchanged; the
        model has no memory, and is always deterministic.

        Raises:
            InputError: if the observation has the wrong shape.
        """
        scenes = as_scenes(observation)
        commands = np.zeros((len(scenes), 2))
        _decide_all(self._path, scenes, commands)
        return as_actions(commands), state


def idm_driver(roadmap: RoadMap, variant: str = "") -> IDMDriver:
    """Make the driver. It has no variants, so `variant` must be empty.

    Raises:
        InputError: if a variant is given.
    """
    if variant:
        raise InputError(f"idm:{variant}: the Intelligent Driver Model has no variants; use --ads idm")
    return IDMDriver(roadmap)


@kernel_inner
def idm_acceleration(speed: float, limit: float, gap: float, leader_speed: float) -> float:
    """Compute the acceleration [m/s2] by equations 1 and 2.

    Args:
        speed: speed v of the ego [m/s].
        limit: desired speed v0 [m/s].
        gap: distance s between the bumpers [m], infinite on a free road.
        leader_speed: speed of the vehicle ahead [m/s].
    """
    approach = speed * (speed - leader_speed) / (2 * math.sqrt(ACCELERATION * BRAKING))
    desired = JAM_GAP + max(speed * TIME_GAP + approach, 0.0)  # s*
    free = math.pow(max(speed, 0.0) / limit, EXPONENT)
    return ACCELERATION * (1 - free - (desired / max(gap, 0.1)) ** 2)


@kernel_in_place
def _decide_all(path: Path, scenes: Floats, commands: Floats) -> None:
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] != 0.0:
            commands[i, 0], commands[i, 1] = _decide(path, scenes[i])


@kernel_inner
def _decide(path: Path, scene: Floats) -> tuple[float, float]:
    speed = scene[EGO, SPEED]
    station, _ = project_on_path(path, scene[EGO, X], scene[EGO, Y])
    gap, leader_speed = _leader(path, scene, station)
    limit = limit_at(path, station)
    acceleration = max(idm_acceleration(speed, limit, gap, leader_speed), -speed / PERIOD)
    low, high = ACCELERATION_RANGE
    return min(max(acceleration, low), high), steer(path, scene, station, 0.0)


@kernel_inner
def _leader(path: Path, scene: Floats, station: float) -> tuple[float, float]:
    """Return the gap [m] to the next vehicle ahead in the ego's lane and direction, and its speed there [m/s]."""
    nearest, leader_speed = math.inf, 0.0
    for i in range(EGO + 1, len(scene)):
        other = scene[i]
        there, aside = project_on_path(path, other[X], other[Y])
        if other[PRESENT] == 0.0 or there <= station:
            continue
        turned = other[HEADING] - pose_on_path(path, there)[2]
        is_on_lane = abs(aside) < (path.lane_width + other[WIDTH]) / 2 - OVERLAP
        goes_along = math.cos(turned) > math.cos(SAME_WAY)
        gap = there - station - (other[LENGTH] + scene[EGO, LENGTH]) / 2
        if is_on_lane and goes_along and gap < nearest:
            nearest, leader_speed = gap, other[SPEED] * math.cos(turned)
    return nearest, leader_speed
