"""highway-env's merges: make room for a vehicle that comes from a ramp (`MergeEnv`, `MergeGenericEnv`).

The formulas of the terms of their reward are in `reward_terms.py`.
"""

from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from highway_env.envs.merge_env import MergeEnv, MergeGenericEnv
from highway_env.road.road import LaneIndex

from behavexplor.envs.engine.lane_geometry import lane_point
from behavexplor.envs.engine.pcg64 import TWO, Words, integer, uniform
from behavexplor.envs.engine.state import Scene
from behavexplor.envs.engine.world import AS_EGO, AS_OTHER, World, place_vehicle
from behavexplor.envs.tasks.reward_terms import CRASHED, FREE_SPEED, LANE_CHANGE, LANE_NUMBER, SLOW_ON_GOAL
from behavexplor.envs.tasks.task import Config, Task, TaskKind, check_discrete
from behavexplor.envs.values import POSITIVE
from behavexplor.errors import InputError
from behavexplor.jit import kernel_inner

_RAMP_LENGTHS: Final = (  # keys of the lengths before the end of the ramp
    "before_merge_length",
    "converge_merge_length",
    "parallel_merge_length",
)
_ROAD_BEYOND_END: Final = 90.0  # length of the road after the end of an episode [m]
_TRIES: Final = 10  # to place a vehicle
_FREE: Final = 15.0  # least distance between the centers of vehicles on a lane [m]

KIND = TaskKind(
    env_classes=(MergeEnv,),
    terms=MappingProxyType(
        {
            "collision_reward": (CRASHED, bool),
            "right_lane_reward": (LANE_NUMBER, float),
            "high_speed_reward": (FREE_SPEED, float),
            "lane_change_reward": (LANE_CHANGE, bool),
            "merging_speed_reward": (SLOW_ON_GOAL, float),
        }
    ),
    worst=("collision_reward", "merging_speed_reward"),
    best=("high_speed_reward", "right_lane_reward"),
    is_normalized=True,
    truncates=False,
    end_x=lambda _: 370.0,  # x beyond which the episode ends [m]
    # the merging lane of a highway with two lanes; highway-env uses this index for any number of lanes
    is_goal=lambda index, _: index == ("b", "c", 2),
    start_lanes=lambda _: (("a", "b", 0), ("a", "b", 1), ("j", "k", 0)),  # the two of the highway, then the ramp
    n_placed=5,
    check=check_discrete,
)


@kernel_inner
def start(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the vehicles: `MergeEnv._make_vehicles`."""
    lanes = world.network.lanes
    starts = task.starts.lanes
    x, y = lane_point(lanes[starts[1]], 30.0)
    place_vehicle(world, scene, AS_EGO, x, y, 0.0, 30.0)
    for station, speed in ((90.0, 29.0), (70.0, 31.0), (5.0, 31.5)):
        lane = starts[integer(words, TWO)]
        x, y = lane_point(lanes[lane], station + uniform(words, -5.0, 5.0))
        place_vehicle(world, scene, AS_OTHER, x, y, 0.0, speed + uniform(words, -1.0, 1.0))
    x, y = lane_point(lanes[starts[2]], 110.0)
    i = place_vehicle(world, scene, AS_OTHER, x, y, 0.0, 20.0)
    scene.vehicles[i].target_speed = 30.0


def _start_lanes(config: Config) -> tuple[LaneIndex, ...]:
    lanes = tuple(("a", "b", number) for number in range(config["lanes_count"]))
    return *lanes, ("j", "k", 0)


def _put_starts(row: Any, config: Config) -> None:
    row.n_others = config["vehicles_count"] + 1  # and the one on the ramp


def _ramp_end(config: Config) -> float:
    """Return the station of the end of the ramp [m]."""
    length: float = sum(config[key] for key in _RAMP_LENGTHS)
    return length


def _check(config: Config) -> None:
    KIND.check(config)
    if config["after_merge_length"] < _ROAD_BEYOND_END:
        raise InputError(
            f"after_merge_length: {config['after_merge_length']} must be at least {_ROAD_BEYOND_END:g} m, because the "
            f"episode ends {_ROAD_BEYOND_END:g} m before the end of the road"
        )


GENERIC_KIND = replace(  # with as many lanes and vehicles as the config says
    KIND,
    env_classes=(MergeGenericEnv,),
    end_x=lambda config: _ramp_end(config) + config["after_merge_length"] - _ROAD_BEYOND_END,
    start_lanes=_start_lanes,
    n_placed=None,
    start_numbers=lambda config: np.array([_ramp_end(config)]),  # vehicles are spread over the road before it
    put_starts=_put_starts,
    keys=MappingProxyType(dict.fromkeys((*_RAMP_LENGTHS, "after_merge_length"), POSITIVE)),
    check=_check,
)


@kernel_inner
def start_generic(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the vehicles: `MergeGenericEnv._make_vehicles`."""
    lanes = world.network.lanes
    starts = task.starts.lanes
    ramp_end = task.starts.numbers[0]
    n_lanes = len(starts) - 1
    x, y = lane_point(lanes[starts[n_lanes - 1]], 30.0)
    place_vehicle(world, scene, AS_EGO, x, y, 0.0, 30.0)
    for _other in range(task.rules[0].n_others - 1):  # but for the one on the ramp
        for _try in range(_TRIES):
            lane = starts[integer(words, n_lanes)]
            x, y = lane_point(lanes[lane], uniform(words, 0.0, ramp_end))
            if _is_free(scene, x, y):
                place_vehicle(world, scene, AS_OTHER, x, y, 0.0, 30.0 + uniform(words, -2.0, 2.0))
                break
    x, y = lane_point(lanes[starts[n_lanes]], 60.0)
    i = place_vehicle(world, scene, AS_OTHER, x, y, 0.0, 20.0)
    scene.vehicles[i].target_speed = 30.0


@kernel_inner
def _is_free(scene: Scene, x: float, y: float) -> bool:
    """Return whether no vehicle is within `_FREE` of x on the lane at y.

    Lanes are parallel to the x axis, so the vehicles on a lane have exactly its y.
    """
    for j in range(scene.episode.n_vehicles):
        if scene.vehicles[j].y == y and abs(x - scene.vehicles[j].x) <= _FREE:
            return False
    return True
