"""Simulate one decision: the ego's command, then frames, each of driving, right of way, motion and collisions."""

import math
from typing import Final

from behavexplor.data.array_types import Floats
from behavexplor.envs.engine.bicycle import move
from behavexplor.envs.engine.contact import collide
from behavexplor.envs.engine.frame_log import log_frame
from behavexplor.envs.engine.lane_geometry import (
    coordinates_on,
    lane_coordinates,
    lane_heading,
    lane_point,
    note_places,
    update_lane,
)
from behavexplor.envs.engine.lane_keeping import keep_lane_and_speed, take_maneuver
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.reactive_traffic import UNKNOWN, drive
from behavexplor.envs.engine.state import (
    IDM,
    LINEAR,
    MDP,
    N_PREDICTIONS,
    PLAIN,
    SAME_NUMBER,
    Records,
    Scene,
    Traits,
    Vehicle,
)
from behavexplor.envs.engine.world import Rules, World
from behavexplor.jit import kernel_inner

PREDICTION_STEP: Final = 0.25  # time between predictions [s]


@kernel_inner
def give_command(world: World, scene: Scene, first: float, second: float) -> None:
    """Begin a decision: add its time and frames to the episode's, and give the ego its command.

    `first` is the ego's acceleration [m/s2], and `second` its steering [rad]; for meta-actions, the first is the index
    of the maneuver in `behavexplor.data.conventions.MANEUVERS`.
    """
    rules, episode = world.rules[0], scene.episode
    episode.time += rules.policy_period
    episode.frames += rules.n_frames
    ego = scene.vehicles[episode.ego]
    if scene.traits[episode.ego].kind == MDP:
        take_maneuver(world.network, world.speeds, ego, scene.routes[episode.ego], int(first))
    else:
        ego.acceleration, ego.steering = first, second


@kernel_inner
def run_frames(network: Network, rules: Rules, scene: Scene, n_frames: int, frames: Records, things: Records) -> None:
    """Simulate frames, each by `Road.act` and `Road.step`, and log them.

    `frames` and `things` are rows of `FrameLog`. Frames for which they have no room are not logged.
    """
    episode = scene.episode
    note_places(network, scene)
    for k in range(n_frames):
        scene.scratch.n_on_lane[:] = UNKNOWN
        for i in range(episode.n_vehicles):
            kind, vehicle = scene.traits[i].kind, scene.vehicles[i]
            if kind == MDP:
                station, offset = coordinates_on(network, scene, i, vehicle.target_lane)
                keep_lane_and_speed(network, vehicle, scene.routes[i], scene.traits[i].length, station, offset)
            elif kind != PLAIN and not vehicle.crashed:
                drive(network, scene, i)
        if rules.regulation_period > 0:  # right of way at intersections
            episode.road_frames += 1
            if episode.road_frames % rules.regulation_period == 0:
                enforce_rules(network, scene)
        for i in range(episode.n_vehicles):
            vehicle, traits = scene.vehicles[i], scene.traits[i]
            if traits.kind in (IDM, LINEAR):
                vehicle.timer += rules.dt
            move(vehicle, traits, rules.dt)
            update_lane(network, scene, i)
        collide(scene.vehicles, scene.traits, episode.n_vehicles, episode.n_obstacles, rules.dt, scene.scratch.xs)
        if k < len(frames):
            log_frame(network, scene, frames[k], things[k])


@kernel_inner
def enforce_rules(network: Network, scene: Scene) -> None:
    """Stop vehicles that must yield, and release those that had to: `RegulatedRoad.enforce_road_rules`.

    Egos never yield.
    """
    n_vehicles = scene.episode.n_vehicles
    for i in range(n_vehicles):
        vehicle = scene.vehicles[i]
        if vehicle.is_yielding:
            vehicle.target_speed = network.lanes[vehicle.lane].speed_limit
            vehicle.is_yielding = False
        _predict(network, scene, i)
    for i in range(n_vehicles - 1):
        for j in range(i + 1, n_vehicles):
            if not _is_conflict(scene, i, j):
                continue
            yielding = i if _is_first_to_yield(network, scene.vehicles[i], scene.vehicles[j]) else j
            if scene.traits[yielding].kind in (IDM, LINEAR):
                scene.vehicles[yielding].target_speed = 0.0
                scene.vehicles[yielding].is_yielding = True


@kernel_inner
def _is_first_to_yield(network: Network, vehicle: Vehicle, other: Vehicle) -> bool:
    """Return whether the first of two vehicles yields: `RegulatedRoad.respect_priorities`."""
    priority, other_priority = network.lanes[vehicle.lane].priority, network.lanes[other.lane].priority
    if priority != other_priority:
        return bool(priority < other_priority)
    dx, dy = other.x - vehicle.x, other.y - vehicle.y
    ahead = vehicle.cos * dx + vehicle.sin * dy
    return bool(ahead > other.cos * (vehicle.x - other.x) + other.sin * (vehicle.y - other.y))


@kernel_inner
def _predict(network: Network, scene: Scene, i: int) -> None:
    """Predict a vehicle's motion at constant speed: `predict_trajectory_constant_speed`."""
    predictions = scene.scratch.predictions[i]
    if scene.traits[i].kind == PLAIN:
        _predict_steered(scene, i, predictions)
        return
    vehicle = scene.vehicles[i]
    station, _ = lane_coordinates(network.lanes[vehicle.lane], vehicle.x, vehicle.y)
    for k in range(N_PREDICTIONS):
        time = PREDICTION_STEP + k * PREDICTION_STEP
        _predict_on_route(network, vehicle, scene.routes[i], station + vehicle.speed * time, predictions[k])


@kernel_inner
def _predict_steered(scene: Scene, i: int, predictions: Floats) -> None:
    """Predict the motion at constant steering, as highway-env does for vehicles that follow no lane."""
    copy = scene.scratch.copy[0]
    scene.scratch.copy[0] = scene.vehicles[i]
    copy.acceleration = 0.0
    for k in range(N_PREDICTIONS):
        move(copy, scene.traits[i], PREDICTION_STEP)
        predictions[k, 0], predictions[k, 1], predictions[k, 2] = copy.x, copy.y, copy.heading


@kernel_inner
def _predict_on_route(network: Network, vehicle: Vehicle, route: Records, station: float, prediction: Floats) -> None:
    """Predict position and heading at a station: `RoadNetwork.position_heading_along_route`."""
    position, length = vehicle.route_position, vehicle.route_length
    lane = vehicle.lane
    if position < length:
        lane = _lane_of_step(network, vehicle, route, position)
        while length - position > 1 and station > network.lanes[lane].length:
            station -= network.lanes[lane].length
            position += 1
            lane = _lane_of_step(network, vehicle, route, position)
    prediction[0], prediction[1] = lane_point(network.lanes[lane], station)
    prediction[2] = lane_heading(network.lanes[lane], station)


@kernel_inner
def _lane_of_step(network: Network, vehicle: Vehicle, route: Records, position: int) -> int:
    """Return the lane of a step of a route. If none is fixed, its number is that of the vehicle's lane."""
    road, number = network.roads[route[position].road], route[position].number
    if number == SAME_NUMBER:
        number = min(network.lanes[vehicle.lane].number, road.n_lanes - 1)
    return int(road.first_lane + number)


@kernel_inner
def _is_conflict(scene: Scene, i: int, j: int) -> bool:
    """Return whether two vehicles may collide soon: `RegulatedRoad.is_conflict_possible`."""
    a, b = scene.scratch.predictions[i], scene.scratch.predictions[j]
    reach = scene.traits[i].length
    for k in range(N_PREDICTIONS):
        dx, dy = b[k, 0] - a[k, 0], b[k, 1] - a[k, 1]
        if math.sqrt(dx * dx + dy * dy) > reach:
            continue
        if _enters(a[k], scene.traits[i], b[k], scene.traits[j]) or _enters(
            b[k], scene.traits[j], a[k], scene.traits[i]
        ):
            return True
    return False


@kernel_inner
def _enters(a: Floats, a_traits: Traits, b: Floats, b_traits: Traits) -> bool:
    """Return whether highway-env finds a corner, a side's middle or the center of box a inside box b.

    This is `highway_env.utils.has_corner_inside`, which rotates points into the frame of b by b's heading, not by its
    opposite. The result is that of highway-env, not that of geometry. Each box is x [m], y [m] and heading [rad].
    """
    cos_a, sin_a, cos_b, sin_b = math.cos(a[2]), math.sin(a[2]), math.cos(b[2]), math.sin(b[2])
    along, aside = 1.5 * a_traits.length / 2, 0.9 * a_traits.width / 2
    half_length, half_width = 1.5 * b_traits.length / 2, 0.9 * b_traits.width / 2
    for u in (-along, 0.0, along):
        for w in (-aside, 0.0, aside):
            dx = cos_a * u + -sin_a * w + a[0] - b[0]
            dy = sin_a * u + cos_a * w + a[1] - b[1]
            x, y = cos_b * dx + -sin_b * dy, sin_b * dx + cos_b * dy
            if abs(x) <= half_length and abs(y) <= half_width:
                return True
    return False
