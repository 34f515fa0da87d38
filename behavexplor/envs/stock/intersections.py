"""The start of an episode of highway-env's `IntersectionEnv`, and the vehicles that appear while it runs."""

import math
from typing import Any, Final

import numpy as np

from behavexplor.envs.engine.lane_geometry import lane_heading, lane_point
from behavexplor.envs.engine.pcg64 import FOUR, NEXT_FORM, THREE, Words, integer, is_given, normal, two_of, uniform
from behavexplor.envs.engine.state import Scene
from behavexplor.envs.stock.placing import AS_EGO, AS_OTHER, draw_behavior, place_vehicle, plan_route
from behavexplor.envs.stock.stock_world import World
from behavexplor.envs.stock.task import DRAWN, Task
from behavexplor.jit import kernel_inner

CHALLENGER: Any = np.bool_(True)  # of numpy's type, as the constants of `pcg64`
NOT_CHALLENGER: Any = np.bool_(False)

N_DRAWS: Final = 6  # of a vehicle that may appear: u of the probability, two choices, two z, and u of `DELTA`
_N_DRAWS: Final = np.uint64(N_DRAWS)
INITIAL_PROBABILITY: Final = 0.6  # probability of each vehicle at the start; `spawn_probability` is for later ones


@kernel_inner
def enter_intersection(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the ego and a vehicle that crosses its way: the last part of `IntersectionEnv._make_vehicles`.

    Args:
        world: the road and the vehicles' classes.
        task: the environment's starts.
        scene: the episode, changed in place. The traffic has driven for three seconds.
        words: its random generator, changed in place.
    """
    rules, starts = task.rules[0], task.starts
    spawn_vehicle(world, task, scene, words, 60.0, 1.0, CHALLENGER)
    destination: int = rules.ego_destination
    if destination == DRAWN:
        destination = 1 + integer(words, THREE)
    lane = world.network.lanes[starts.lanes[0]]
    x, y = lane_point(lane, 60.0 + 5.0 * (1.0 + normal(words)))
    ego = place_vehicle(world, scene, AS_EGO, x, y, lane_heading(lane, 60.0), lane.speed_limit)
    plan_route(world, scene, ego, starts.plans[destination])
    _clear_around(scene, ego)


@kernel_inner
def spawn_vehicle(
    world: World, task: Task, scene: Scene, words: Words, station: float, probability: float, is_challenger: bool
) -> None:
    """Let a vehicle appear, or not: `IntersectionEnv._spawn_vehicle`.

    If draws are given, there are `N_DRAWS` for each call, also for one that needs less because no vehicle appears.

    Args:
        world: the road and the vehicles' classes.
        task: the environment's starts.
        scene: the episode, changed in place.
        words: its random generator, changed in place.
        station: station about which it appears [m].
        probability: probability that it appears, unless there is no room.
        is_challenger: whether it goes straight on, and starts at nearly the same place and speed every time.
    """
    first, given = words[NEXT_FORM], is_given(words)
    _spawn(world, task, scene, words, station, probability, is_challenger)
    if given:
        words[NEXT_FORM] = first + _N_DRAWS


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
