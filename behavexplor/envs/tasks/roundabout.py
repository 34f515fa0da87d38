"""highway-env's roundabout: enter it and leave it at the second exit (`RoundaboutEnv`)."""

from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from highway_env.envs.roundabout_env import RoundaboutEnv

from behavexplor.envs.engine.lane_geometry import lane_heading, lane_point
from behavexplor.envs.engine.pcg64 import THREE, Words, integer
from behavexplor.envs.engine.state import Scene
from behavexplor.envs.engine.world import AS_EGO, World, draw_behavior, place_nearby, place_vehicle, plan_route
from behavexplor.envs.tasks.reward_terms import CRASHED, DEFAULT_SPEED_CHOICE, LANE_CHANGE, ON_ROAD
from behavexplor.envs.tasks.task import DRAWN, Config, Task, TaskKind, check_discrete
from behavexplor.envs.values import Kind, optional
from behavexplor.jit import kernel_inner

# others draw one of the first three, in this order; the last is the ego's
_DESTINATIONS: Final = ("exr", "sxr", "nxr", "nxs")


def _put_starts(row: Any, config: Config) -> None:
    row.ego_destination = _DESTINATIONS.index("nxs")
    if config["incoming_vehicle_destination"] is not None:
        row.destination = config["incoming_vehicle_destination"]


KIND = TaskKind(
    env_classes=(RoundaboutEnv,),
    terms=MappingProxyType(
        {
            "collision_reward": (CRASHED, bool),
            "high_speed_reward": (DEFAULT_SPEED_CHOICE, np.float64),
            "lane_change_reward": (LANE_CHANGE, bool),
            "on_road_reward": (ON_ROAD, np.bool_),
        }
    ),
    best=("high_speed_reward",),
    gate="on_road_reward",
    start_lanes=lambda _: (("ser", "ses", 0), ("we", "sx", 0), ("we", "sx", 1), ("eer", "ees", 0)),
    destinations=_DESTINATIONS,
    n_placed=5,
    put_starts=_put_starts,
    keys=MappingProxyType({"incoming_vehicle_destination": optional(Kind("0, 1 or 2", Literal[0, 1, 2]))}),
    unread=frozenset({"right_lane_reward"}),
    check=check_discrete,
)


@kernel_inner
def start(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the vehicles: `RoundaboutEnv._make_vehicles`."""
    rules, starts = task.rules[0], task.starts
    lane = world.network.lanes[starts.lanes[0]]
    x, y = lane_point(lane, 125.0)
    i = place_vehicle(world, scene, AS_EGO, x, y, lane_heading(lane, 140.0), 8.0)
    plan_route(world, scene, i, starts.plans[rules.ego_destination])
    for place, station in ((2, 5.0), (1, 20.0), (1, -20.0), (3, 50.0)):
        i = place_nearby(world, scene, words, starts.lanes[place], station, 16.0)
        destination: int = rules.destination
        if place != 2 or destination == DRAWN:  # the option holds for the first of them only
            destination = integer(words, THREE)
        plan_route(world, scene, i, starts.plans[destination])
        draw_behavior(words, scene, i)
