"""highway-env's highway: overtake other vehicles and keep to the right (`HighwayEnv`, `HighwayEnvFast`)."""

import math
from types import MappingProxyType
from typing import Any

import numpy as np
from highway_env.envs.highway_env import HighwayEnv, HighwayEnvFast

from behavexplor.envs.engine.lane_geometry import lane_coordinates
from behavexplor.envs.engine.pcg64 import Words, integer, uniform
from behavexplor.envs.engine.state import Scene
from behavexplor.envs.engine.world import AS_EGO, AS_OTHER, World, draw_behavior, place_on_lane
from behavexplor.envs.tasks.reward_terms import CRASHED, ON_ROAD, SPEED_AHEAD, TARGET_LANE
from behavexplor.envs.tasks.task import DRAWN, Config, Task, TaskKind
from behavexplor.errors import InputError
from behavexplor.jit import kernel_inner


def put_spacing(row: Any, config: Config) -> None:
    """Put the number of other vehicles, and the numbers for `place_in_front`, into a record of `TASK`."""
    row.n_others = config["vehicles_count"]
    row.ego_spacing, row.spacing = config["ego_spacing"], 1 / config["vehicles_density"]
    row.lane_factor = np.exp(-5 / 40 * config["lanes_count"])


def _put_starts(row: Any, config: Config) -> None:
    put_spacing(row, config)
    row.low_start_speed, row.high_start_speed = 0.7 * 30, 0.8 * 30  # of the speed limit of `_create_road`
    if config["initial_lane_id"] is not None:
        row.ego_lane = config["initial_lane_id"]


def _check(config: Config) -> None:
    lane, lanes = config["initial_lane_id"], config["lanes_count"]
    if lane is not None and lane >= lanes:
        raise InputError(f"initial_lane_id: {lane} must be below lanes_count {lanes}")


KIND = TaskKind(
    env_classes=(HighwayEnvFast, HighwayEnv),
    terms=MappingProxyType(
        {
            "collision_reward": (CRASHED, float),
            "right_lane_reward": (TARGET_LANE, np.float64),
            "high_speed_reward": (SPEED_AHEAD, np.float64),
            "on_road_reward": (ON_ROAD, float),
        }
    ),
    best=("high_speed_reward", "right_lane_reward"),
    gate="on_road_reward",
    may_end_off_road=True,
    start_lanes=lambda config: tuple(("0", "1", number) for number in range(config["lanes_count"])),
    put_starts=_put_starts,
    unaware=(HighwayEnvFast,),
    unread=frozenset({"lane_change_reward"}),
    check=_check,
)


@kernel_inner
def start(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the vehicles: `HighwayEnv._create_vehicles`."""
    rules, lanes = task.rules[0], task.starts.lanes
    lane: int = rules.ego_lane
    if lane == DRAWN:
        lane = integer(words, len(lanes))
    place_in_front(world, task, scene, words, AS_EGO, lanes[lane], 25.0)
    for _ in range(rules.n_others):
        lane = lanes[integer(words, len(lanes))]
        speed = uniform(words, rules.low_start_speed, rules.high_start_speed)
        i = place_in_front(world, task, scene, words, AS_OTHER, lane, speed)
        draw_behavior(words, scene, i)


@kernel_inner
def place_in_front(world: World, task: Task, scene: Scene, words: Words, template: int, lane: int, speed: float) -> int:
    """Add a vehicle in front of all others, as seen from a lane: `Vehicle.create_random`."""
    rules = task.rules[0]
    offset = (rules.ego_spacing if template == AS_EGO else rules.spacing) * (12 + 1.0 * speed) * rules.lane_factor
    station = 3 * offset
    if scene.episode.n_vehicles > 0:
        station = -math.inf
        for j in range(scene.episode.n_vehicles):
            other = scene.vehicles[j]
            station = max(station, lane_coordinates(world.network.lanes[lane], other.x, other.y)[0])
    station += offset * uniform(words, 0.9, 1.1)
    return place_on_lane(world, scene, template, lane, station, speed)
