"""highway-env's two-way road: overtake vehicles in spite of oncoming traffic (`TwoWayEnv`)."""

from types import MappingProxyType

import numpy as np
from highway_env.envs.two_way_env import TwoWayEnv

from behavexplor.envs.engine.lane_geometry import lane_heading, lane_point
from behavexplor.envs.engine.pcg64 import Words, normal
from behavexplor.envs.engine.state import Scene
from behavexplor.envs.engine.world import AS_EGO, AS_OTHER, World, place_vehicle
from behavexplor.envs.tasks.reward_terms import LEFT_LANE, SPEED_CHOICE
from behavexplor.envs.tasks.task import Config, Task, TaskKind
from behavexplor.errors import InputError
from behavexplor.jit import kernel_inner


def _check(config: Config) -> None:
    if config["action"]["type"] != "DiscreteMetaAction":
        raise InputError("action: highway-env's two-way environment itself needs the action type DiscreteMetaAction")


KIND = TaskKind(
    env_classes=(TwoWayEnv,),
    terms=MappingProxyType(
        {"high_speed_reward": (SPEED_CHOICE, np.float64), "left_lane_reward": (LEFT_LANE, np.float64)}
    ),
    is_normalized=False,
    truncates=False,
    start_lanes=lambda _: (("a", "b", 1), ("b", "a", 0)),
    n_placed=6,
    unread=frozenset({"collision_reward", "left_lane_constraint"}),
    check=_check,
)


@kernel_inner
def start(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the vehicles: `TwoWayEnv._make_vehicles`."""
    lanes, starts = world.network.lanes, task.starts
    x, y = lane_point(lanes[starts.lanes[0]], 30.0)
    place_vehicle(world, scene, AS_EGO, x, y, 0.0, 30.0)
    for k in range(5):
        lane = starts.lanes[0] if k < 3 else starts.lanes[1]
        station = 70.0 + 40.0 * k if k < 3 else 200.0 + 100.0 * (k - 3)
        x, y = lane_point(lanes[lane], station + 10.0 * normal(words))
        speed = 24.0 + 2.0 * normal(words) if k < 3 else 20.0 + 5.0 * normal(words)
        i = place_vehicle(world, scene, AS_OTHER, x, y, lane_heading(lanes[lane], station), speed)
        scene.traits[i].changes_lanes = False
        if k >= 3:
            scene.vehicles[i].target_lane = lane
