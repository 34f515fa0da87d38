"""highway-env's merge: make room for a vehicle that comes from a ramp (`MergeEnv`)."""

from types import MappingProxyType

from highway_env.envs.merge_env import MergeEnv

from behavexplor.envs.engine.lane_geometry import lane_point
from behavexplor.envs.engine.pcg64 import TWO, Words, integer, uniform
from behavexplor.envs.engine.state import Scene
from behavexplor.envs.engine.world import AS_EGO, AS_OTHER, World, place_vehicle
from behavexplor.envs.tasks.reward_terms import CRASHED, FREE_SPEED, LANE_CHANGE, LANE_NUMBER, SLOW_ON_GOAL
from behavexplor.envs.tasks.task import Task, TaskKind, check_discrete
from behavexplor.jit import kernel_inner

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
    end_x=lambda _: 370.0,
    is_goal=lambda index, _: index == ("b", "c", 2),  # the merging lane
    start_lanes=lambda _: (("a", "b", 0), ("a", "b", 1), ("j", "k", 0)),
    n_placed=5,
    check=check_discrete,
)


@kernel_inner
def start(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the vehicles: `MergeEnv._make_vehicles`."""
    lanes, starts = world.network.lanes, task.starts
    x, y = lane_point(lanes[starts.lanes[1]], 30.0)
    place_vehicle(world, scene, AS_EGO, x, y, 0.0, 30.0)
    for station, speed in ((90.0, 29.0), (70.0, 31.0), (5.0, 31.5)):
        lane = starts.lanes[integer(words, TWO)]
        x, y = lane_point(lanes[lane], station + uniform(words, -5.0, 5.0))
        place_vehicle(world, scene, AS_OTHER, x, y, 0.0, speed + uniform(words, -1.0, 1.0))
    x, y = lane_point(lanes[starts.lanes[2]], 110.0)
    i = place_vehicle(world, scene, AS_OTHER, x, y, 0.0, 20.0)
    scene.vehicles[i].target_speed = 30.0
