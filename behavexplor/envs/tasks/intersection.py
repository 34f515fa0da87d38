"""highway-env's intersection: cross it, where the traffic from the sides has priority (`IntersectionEnv`)."""

import math
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from highway_env.envs.intersection_env import IntersectionEnv

from behavexplor.data.array_types import Floats
from behavexplor.envs.engine.lane_geometry import lane_coordinates, lane_heading, lane_point
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.pcg64 import FOUR, NEXT_GIVEN, THREE, Words, integer, is_given, normal, two_of, uniform
from behavexplor.envs.engine.state import MDP, NO_ROUTE, PLAIN, Scene
from behavexplor.envs.engine.world import AS_EGO, AS_OTHER, World, draw_behavior, place_vehicle, plan_route
from behavexplor.envs.tasks.reward_terms import ARRIVED, CRASHED, ON_ROAD, SPEED
from behavexplor.envs.tasks.task import DRAWN, Config, Task, TaskKind
from behavexplor.envs.values import COUNT, NUMBER, one_of, optional
from behavexplor.jit import kernel_inner

CHALLENGER: Any = np.bool_(True)  # of numpy's type, as the constants of `pcg64`
NOT_CHALLENGER: Any = np.bool_(False)

N_DRAWS: Final = 6  # of a vehicle that may appear: u of the probability, two choices, two z, and u of `DELTA`
_N_DRAWS: Final = np.uint64(N_DRAWS)
_INITIAL_PROBABILITY: Final = 0.6  # probability of each vehicle at the start; `spawn_probability` is for later ones
_DESTINATIONS: Final = ("o0", "o1", "o2", "o3")


def _put_starts(row: Any, config: Config) -> None:
    row.n_others = config["initial_vehicle_count"]
    row.n_warm_up = 3 * config["simulation_frequency"]
    row.spawn_probability = config["spawn_probability"]
    if config["destination"]:
        row.ego_destination = _DESTINATIONS.index(config["destination"])


def _gaps(config: Config) -> Floats:
    """Return the offsets along the lanes of the vehicles that are there from the start [m], shape (n,)."""
    count = config["initial_vehicle_count"]
    return np.linspace(0, 80, count)[: count - 1].copy()


KIND = TaskKind(
    env_classes=(IntersectionEnv,),
    terms=MappingProxyType(
        {
            "collision_reward": (CRASHED, float),
            "high_speed_reward": (SPEED, np.float64),
            "arrived_reward": (ARRIVED, float),
            "on_road_reward": (ON_ROAD, float),
        }
    ),
    best=("arrived_reward",),
    first_gate="on_road_reward",
    arrival="arrived_reward",
    arrival_station=25.0,
    has_agents=True,
    has_newcomers=True,
    may_end_off_road=True,
    is_goal=lambda index, _: "il" in index[0] and "o" in index[1],  # the lanes that lead out of it
    start_lanes=lambda _: tuple((f"o{side}", f"ir{side}", 0) for side in range(4)),
    destinations=_DESTINATIONS,
    start_numbers=_gaps,
    put_starts=_put_starts,
    keys=MappingProxyType(
        {"destination": optional(one_of(_DESTINATIONS)), "initial_vehicle_count": COUNT, "spawn_probability": NUMBER}
    ),
)


@kernel_inner
def start(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the traffic that drives before the ego appears: the first part of `IntersectionEnv._make_vehicles`."""
    for gap in task.starts.numbers:
        _spawn_vehicle(world, task, scene, words, gap, _INITIAL_PROBABILITY, NOT_CHALLENGER)


@kernel_inner
def enter(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the ego and a vehicle that crosses its way: the last part of `IntersectionEnv._make_vehicles`.

    The traffic has driven for three seconds.
    """
    rules, starts = task.rules[0], task.starts
    _spawn_vehicle(world, task, scene, words, 60.0, 1.0, CHALLENGER)
    destination: int = rules.ego_destination
    if destination == DRAWN:
        destination = 1 + integer(words, THREE)
    lane = world.network.lanes[starts.lanes[0]]
    x, y = lane_point(lane, 60.0 + 5.0 * (1.0 + normal(words)))
    ego = place_vehicle(world, scene, AS_EGO, x, y, lane_heading(lane, 60.0), lane.speed_limit)
    plan_route(world, scene, ego, starts.plans[destination])
    _clear_around(scene, ego)


@kernel_inner
def renew_traffic(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Remove the vehicles that leave the intersection, and let a new one appear: the end of `IntersectionEnv.step`."""
    clear_vehicles(world.network, scene)
    _spawn_vehicle(world, task, scene, words, 0.0, task.rules[0].spawn_probability, NOT_CHALLENGER)


@kernel_inner
def _spawn_vehicle(
    world: World, task: Task, scene: Scene, words: Words, station: float, probability: float, is_challenger: bool
) -> None:
    """Let a vehicle appear, or not: `IntersectionEnv._spawn_vehicle`.

    It appears about a `station` [m] with a `probability`, unless there is no room. A challenger goes straight on, and
    starts at nearly the same place and speed every time.

    If draws are given, there are `N_DRAWS` for each call, also for one that needs less because no vehicle appears.
    """
    first, given = words[NEXT_GIVEN], is_given(words)
    _spawn(world, task, scene, words, station, probability, is_challenger)
    if given:
        words[NEXT_GIVEN] = first + _N_DRAWS


@kernel_inner
def _spawn(
    world: World, task: Task, scene: Scene, words: Words, station: float, probability: float, is_challenger: bool
) -> None:
    if uniform(words, 0.0, 1.0) > probability:
        return
    origin, destination = two_of(words, FOUR)
    if is_challenger:
        destination = (origin + 2) % 4
    station = station + 5.0 + normal(words) * (0.1 if is_challenger else 1.0)
    speed = 8.0 + normal(words) * (0.0 if is_challenger else 1.0)
    lane = world.network.lanes[task.starts.lanes[origin]]
    x, y = lane_point(lane, station)
    for j in range(scene.episode.n_vehicles):
        if _distance(scene, j, x, y) < 15:
            return
    i = place_vehicle(world, scene, AS_OTHER, x, y, lane_heading(lane, station), speed)
    plan_route(world, scene, i, task.starts.plans[destination])
    draw_behavior(words, scene, i)


@kernel_inner
def _clear_around(scene: Scene, ego: int) -> None:
    """Remove the vehicles within 20 m of the ego, which is the last one. The others keep their order."""
    x, y = scene.vehicles[ego].x, scene.vehicles[ego].y
    kept = 0
    for i in range(ego + 1):
        if i < ego and _distance(scene, i, x, y) < 20:
            continue
        if kept < i:
            scene.vehicles[kept], scene.traits[kept] = scene.vehicles[i], scene.traits[i]
            for k in range(scene.vehicles[i].route_length):
                scene.routes[kept, k] = scene.routes[i, k]
        kept += 1
    scene.episode.n_vehicles, scene.episode.ego = kept, kept - 1


@kernel_inner
def _distance(scene: Scene, i: int, x: float, y: float) -> float:
    dx, dy = scene.vehicles[i].x - x, scene.vehicles[i].y - y
    return math.sqrt(dx * dx + dy * dy)


@kernel_inner
def clear_vehicles(network: Network, scene: Scene) -> None:
    """Remove the traffic that leaves an intersection, in its order: `IntersectionEnv._clear_vehicles`.

    The scene has no obstacles.
    """
    kept = 0
    for i in range(scene.episode.n_vehicles):
        is_ego = scene.traits[i].kind in (PLAIN, MDP)
        if not is_ego and _is_leaving(network, scene, i):
            continue
        if kept != i:
            scene.vehicles[kept], scene.traits[kept] = scene.vehicles[i], scene.traits[i]
            for k in range(scene.vehicles[i].route_length):
                scene.routes[kept, k] = scene.routes[i, k]
            if scene.episode.ego == i:
                scene.episode.ego = kept
        kept += 1
    scene.episode.n_vehicles = kept


@kernel_inner
def _is_leaving(network: Network, scene: Scene, i: int) -> bool:
    vehicle = scene.vehicles[i]
    if vehicle.route_length == NO_ROUTE:
        return True
    lane = network.lanes[vehicle.lane]
    station, _ = lane_coordinates(lane, vehicle.x, vehicle.y)
    return bool(lane.is_goal and station >= lane.length - 4 * scene.traits[i].length)
