"""The start of an episode in each environment, with the draws of highway-env's `_make_vehicles` in their order."""

import math

from behavexplor.envs.engine.lane_geometry import lane_coordinates, lane_heading, lane_point
from behavexplor.envs.engine.pcg64 import THREE, TWO, Words, integer, normal, uniform, weighted
from behavexplor.envs.engine.state import Scene
from behavexplor.envs.stock.intersections import INITIAL_PROBABILITY, NOT_CHALLENGER, spawn_vehicle
from behavexplor.envs.stock.placing import AS_EGO, AS_OTHER, draw_behavior, place_on_lane, place_vehicle, plan_route
from behavexplor.envs.stock.stock_world import BARRIER, World
from behavexplor.envs.stock.task import (
    DRAWN,
    EXIT,
    HIGHWAY,
    MERGE,
    ROUNDABOUT,
    TWO_WAY,
    U_TURN,
    Task,
)
from behavexplor.jit import kernel_inner


@kernel_inner
def start(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the first vehicles of an episode: `AbstractEnv._reset`, without the part of an intersection's ego.

    Args:
        world: the road and the vehicles' classes.
        task: the environment's starts.
        scene: the episode, changed in place.
        words: its random generator, changed in place; see `behavexplor.envs.engine.pcg64`.
    """
    episode, kind = scene.episode, task.rules[0].kind
    episode.n_vehicles = episode.n_obstacles = episode.n_numbered = 0
    episode.ego = episode.frames = episode.road_frames = 0
    episode.time = 0.0
    if kind == HIGHWAY:
        _start_on_highway(world, task, scene, words)
    elif kind == MERGE:
        _start_at_merge(world, task, scene, words)
    elif kind == ROUNDABOUT:
        _start_at_roundabout(world, task, scene, words)
    elif kind == TWO_WAY:
        _start_on_two_way_road(world, task, scene, words)
    elif kind == EXIT:
        _start_at_exit(world, task, scene, words)
    elif kind == U_TURN:
        _start_at_u_turn(world, task, scene, words)
    else:
        for gap in task.starts.gaps:
            spawn_vehicle(world, task, scene, words, gap, INITIAL_PROBABILITY, NOT_CHALLENGER)
    for k in range(len(task.starts.obstacles)):
        scene.vehicles[episode.n_vehicles + k] = task.starts.obstacles[k]
        scene.traits[episode.n_vehicles + k] = world.templates[BARRIER]
        scene.vehicles[episode.n_vehicles + k].number = episode.n_numbered
        episode.n_numbered += 1
    episode.n_obstacles = len(task.starts.obstacles)


@kernel_inner
def _start_on_highway(world: World, task: Task, scene: Scene, words: Words) -> None:
    rules, lanes = task.rules[0], task.starts.lanes
    lane: int = rules.ego_lane
    if lane == DRAWN:
        lane = integer(words, len(lanes))
    _place_at_random(world, task, scene, words, AS_EGO, lanes[lane], 25.0)
    for _ in range(rules.n_others):
        lane = lanes[integer(words, len(lanes))]
        speed = uniform(words, rules.low_start_speed, rules.high_start_speed)
        i = _place_at_random(world, task, scene, words, AS_OTHER, lane, speed)
        draw_behavior(words, scene, i)


@kernel_inner
def _start_at_exit(world: World, task: Task, scene: Scene, words: Words) -> None:
    first = task.starts.lanes[0]
    _place_at_random(world, task, scene, words, AS_EGO, first, 25.0)
    for _ in range(task.rules[0].n_others):
        lane = first + weighted(words, task.starts.shares)
        i = _place_at_random(world, task, scene, words, AS_OTHER, lane, world.network.lanes[lane].speed_limit)
        plan_route(world, scene, i, task.starts.plans[0])
        scene.traits[i].changes_lanes = False


@kernel_inner
def _place_at_random(
    world: World, task: Task, scene: Scene, words: Words, template: int, lane: int, speed: float
) -> int:
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


@kernel_inner
def _start_at_merge(world: World, task: Task, scene: Scene, words: Words) -> None:
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


@kernel_inner
def _start_at_roundabout(world: World, task: Task, scene: Scene, words: Words) -> None:
    rules, starts = task.rules[0], task.starts
    lane = world.network.lanes[starts.lanes[0]]
    x, y = lane_point(lane, 125.0)
    i = place_vehicle(world, scene, AS_EGO, x, y, lane_heading(lane, 140.0), 8.0)
    plan_route(world, scene, i, starts.plans[rules.ego_destination])
    for start, station in ((2, 5.0), (1, 20.0), (1, -20.0), (3, 50.0)):
        i = _place_nearby(world, scene, words, starts.lanes[start], station, 16.0)
        destination: int = rules.destination
        if start != 2 or destination == DRAWN:  # the option holds for the first of them only
            destination = integer(words, THREE)
        plan_route(world, scene, i, starts.plans[destination])
        draw_behavior(words, scene, i)


@kernel_inner
def _start_at_u_turn(world: World, task: Task, scene: Scene, words: Words) -> None:
    starts = task.starts
    x, y = lane_point(world.network.lanes[starts.lanes[0]], 0.0)
    i = place_vehicle(world, scene, AS_EGO, x, y, 0.0, 16.0)
    plan_route(world, scene, i, starts.plans[0])
    vehicles = ((0, 25.0, 13.5), (1, 56.0, 14.5), (3, 0.5, 4.5), (2, 17.5, 5.5), (4, 1.0, 3.5), (5, 30.0, 5.5))
    for start, station, speed in vehicles:
        i = _place_nearby(world, scene, words, starts.lanes[start], station, speed)
        plan_route(world, scene, i, starts.plans[0])
        if i == 1:
            draw_behavior(words, scene, i)


@kernel_inner
def _place_nearby(world: World, scene: Scene, words: Words, lane: int, station: float, speed: float) -> int:
    """Add a vehicle around a station of a lane, with a standard deviation of 2 m and 2 m/s."""
    station += normal(words) * 2.0
    return place_on_lane(world, scene, AS_OTHER, lane, station, speed + normal(words) * 2.0)


@kernel_inner
def _start_on_two_way_road(world: World, task: Task, scene: Scene, words: Words) -> None:
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
