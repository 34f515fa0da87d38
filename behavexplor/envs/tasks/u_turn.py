"""highway-env's U-turn: overtake vehicles in a bend of 180 degrees (`UTurnEnv`)."""

from types import MappingProxyType

import numpy as np
from highway_env.envs.u_turn_env import UTurnEnv

from behavexplor.envs.engine.lane_geometry import lane_point
from behavexplor.envs.engine.pcg64 import Words
from behavexplor.envs.engine.state import Scene
from behavexplor.envs.engine.world import AS_EGO, World, draw_behavior, place_nearby, place_vehicle, plan_route
from behavexplor.envs.tasks.reward_terms import CRASHED, LANE, ON_ROAD, SPEED
from behavexplor.envs.tasks.task import Task, TaskKind
from behavexplor.jit import kernel_inner

KIND = TaskKind(
    env_classes=(UTurnEnv,),
    terms=MappingProxyType(
        {
            "collision_reward": (CRASHED, bool),
            "left_lane_reward": (LANE, float),
            "high_speed_reward": (SPEED, np.float64),
            "on_road_reward": (ON_ROAD, np.bool_),
        }
    ),
    best=("high_speed_reward", "left_lane_reward"),
    gate="on_road_reward",
    start_lanes=lambda _: (("a", "b", 0), ("a", "b", 1), ("b", "c", 0), ("b", "c", 1), ("c", "d", 0), ("c", "d", 1)),
    destinations=("d",),
    n_placed=7,
    unread=frozenset({"offroad_terminal"}),
)


@kernel_inner
def start(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the vehicles: `UTurnEnv._make_vehicles`."""
    starts = task.starts
    x, y = lane_point(world.network.lanes[starts.lanes[0]], 0.0)
    i = place_vehicle(world, scene, AS_EGO, x, y, 0.0, 16.0)
    plan_route(world, scene, i, starts.plans[0])
    vehicles = ((0, 25.0, 13.5), (1, 56.0, 14.5), (3, 0.5, 4.5), (2, 17.5, 5.5), (4, 1.0, 3.5), (5, 30.0, 5.5))
    for lane, station, speed in vehicles:
        i = place_nearby(world, scene, words, starts.lanes[lane], station, speed)
        plan_route(world, scene, i, starts.plans[0])
        if i == 1:
            draw_behavior(words, scene, i)
