"""highway-env's exit: leave the highway by the lane on the right (`ExitEnv`)."""

from types import MappingProxyType

import numpy as np
from highway_env.envs.exit_env import ExitEnv

from behavexplor.data.array_types import Floats
from behavexplor.envs.engine.pcg64 import Words, weighted
from behavexplor.envs.engine.state import Scene
from behavexplor.envs.engine.world import AS_EGO, AS_OTHER, World, plan_route
from behavexplor.envs.tasks.highway import place_in_front, put_spacing
from behavexplor.envs.tasks.reward_terms import CRASHED, GOAL_LANE, SPEED, TARGET_LANE_NUMBER
from behavexplor.envs.tasks.task import Config, Task, TaskKind
from behavexplor.errors import InputError
from behavexplor.jit import kernel_inner


def _lane_shares(config: Config) -> Floats:
    """Return the cumulated probabilities of the lanes on which other vehicles start, shape (lanes,)."""
    shares = np.arange(config["lanes_count"])
    cumulated = (shares / shares.sum()).cumsum()
    found: Floats = cumulated / cumulated[-1]
    return found


def _check(config: Config) -> None:
    if config["lanes_count"] < 2:
        raise InputError("lanes_count: highway-env's exit environment itself needs at least 2 lanes")


KIND = TaskKind(
    env_classes=(ExitEnv,),
    terms=MappingProxyType(
        {
            "collision_reward": (CRASHED, bool),
            "goal_reward": (GOAL_LANE, bool),
            "high_speed_reward": (SPEED, np.float64),
            "right_lane_reward": (TARGET_LANE_NUMBER, int),
        }
    ),
    best=("goal_reward",),
    is_clipped=True,
    has_exit=True,
    success="goal_reward",
    is_goal=lambda index, config: index in (("1", "2", config["lanes_count"]), ("2", "exit", 0)),
    start_lanes=lambda _: (("0", "1", 0),),
    destinations=("3",),
    start_numbers=_lane_shares,
    put_starts=put_spacing,
    unread=frozenset({"initial_lane_id", "lane_change_reward", "offroad_terminal"}),
    check=_check,
)


@kernel_inner
def start(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the vehicles: `ExitEnv._create_vehicles`."""
    first = task.starts.lanes[0]
    place_in_front(world, task, scene, words, AS_EGO, first, 25.0)
    for _ in range(task.rules[0].n_others):
        lane = first + weighted(words, task.starts.numbers)
        i = place_in_front(world, task, scene, words, AS_OTHER, lane, world.network.lanes[lane].speed_limit)
        plan_route(world, scene, i, task.starts.plans[0])
        scene.traits[i].changes_lanes = False
