"""New vehicles: the constructors of highway-env's vehicle classes, routes and drawn behaviors."""

import math
from typing import Any

import numpy as np
from highway_env.vehicle.behavior import LinearVehicle
from numpy.typing import NDArray

from behavexplor.envs.engine.lane_geometry import closest_lane, lane_heading, lane_point
from behavexplor.envs.engine.lane_keeping import nearest_speed
from behavexplor.envs.engine.pcg64 import Words, normal, uniform
from behavexplor.envs.engine.state import IDM, LINEAR, MDP, NO_LANE, NO_ROUTE, PLAIN, SAME_NUMBER, Scene
from behavexplor.envs.engine.world import EGO, OTHER, World
from behavexplor.jit import kernel_inner

Ints = NDArray[np.int64]

# Numba would compile a function once more for each constant of Python's own type.
FIRST_LANE: Any = np.int64(0)
AS_EGO: Any = np.int64(EGO)
AS_OTHER: Any = np.int64(OTHER)

_GAINS: tuple[tuple[float, ...], ...] = tuple(
    tuple(map(float, gains)) for gains in (*LinearVehicle.ACCELERATION_RANGE, *LinearVehicle.STEERING_RANGE)
)


@kernel_inner
def place_vehicle(world: World, scene: Scene, template: int, x: float, y: float, heading: float, speed: float) -> int:
    """Add a vehicle behind all others in the list, and return its place.

    Args:
        world: the road and the vehicles' classes.
        scene: the episode, changed in place. It has no obstacles yet.
        template: AS_EGO or AS_OTHER, the vehicle's class.
        x: position [m].
        y: position [m].
        heading: heading [rad].
        speed: speed [m/s], also the target speed.
    """
    i: int = scene.episode.n_vehicles
    scene.episode.n_vehicles = i + 1
    scene.traits[i] = world.templates[template]
    vehicle, traits = scene.vehicles[i], scene.traits[i]
    vehicle.number = scene.episode.n_numbered
    scene.episode.n_numbered += 1
    vehicle.x, vehicle.y, vehicle.heading, vehicle.speed = x, y, heading, speed
    vehicle.cos, vehicle.sin = math.cos(heading), math.sin(heading)
    vehicle.steering = vehicle.acceleration = vehicle.impact_x = vehicle.impact_y = vehicle.timer = 0.0
    vehicle.has_impact = vehicle.crashed = vehicle.is_yielding = False
    vehicle.speed_index = vehicle.route_position = 0
    vehicle.route_length = NO_ROUTE
    vehicle.lane, _, _ = closest_lane(world.network, FIRST_LANE, x, y, heading)
    vehicle.target_lane, vehicle.target_speed = vehicle.lane, speed
    if traits.kind == PLAIN:
        vehicle.target_lane, vehicle.target_speed = NO_LANE, 0.0
    elif traits.kind == MDP:
        vehicle.speed_index = nearest_speed(world.speeds, speed)
        vehicle.target_speed = world.speeds[vehicle.speed_index]
    else:
        vehicle.timer = ((x + y) * math.pi) % traits.lane_change_delay
    return i


@kernel_inner
def place_on_lane(world: World, scene: Scene, template: int, lane: int, station: float, speed: float) -> int:
    """Add a vehicle at a station [m] of a lane, in the lane's direction: `RoadObject.make_on_lane`."""
    x, y = lane_point(world.network.lanes[lane], station)
    return place_vehicle(world, scene, template, x, y, lane_heading(world.network.lanes[lane], station), speed)


@kernel_inner
def place_nearby(world: World, scene: Scene, words: Words, lane: int, station: float, speed: float) -> int:
    """Add a vehicle around a station of a lane, with a standard deviation of 2 m and 2 m/s."""
    station += normal(words) * 2.0
    return place_on_lane(world, scene, AS_OTHER, lane, station, speed + normal(words) * 2.0)


@kernel_inner
def plan_route(world: World, scene: Scene, i: int, plans: Ints) -> None:
    """Plan the route of vehicle i from its lane to a destination: `ControlledVehicle.plan_route_to`.

    Args:
        world: the road.
        scene: the episode, changed in place.
        i: the vehicle.
        plans: roads of the route from every road, padded with -1, shape (roads, steps).
    """
    if scene.traits[i].kind == PLAIN:
        return
    vehicle = scene.vehicles[i]
    lane = world.network.lanes[vehicle.lane]
    vehicle.route_length = 0
    for road in plans[lane.road]:
        if road < 0:
            break
        scene.routes[i, vehicle.route_length].road = road
        scene.routes[i, vehicle.route_length].number = lane.number if vehicle.route_length == 0 else SAME_NUMBER
        vehicle.route_length += 1


@kernel_inner
def draw_behavior(words: Words, scene: Scene, i: int) -> None:
    """Draw the behavior of vehicle i: `randomize_behavior` of `IDMVehicle` or `LinearVehicle`."""
    traits = scene.traits[i]
    if traits.kind == LINEAR:
        low, high, low_steering, high_steering = _GAINS
        traits.speed_gain = low[0] + uniform(words, 0.0, 1.0) * (high[0] - low[0])
        traits.front_speed_gain = low[1] + uniform(words, 0.0, 1.0) * (high[1] - low[1])
        traits.front_gap_gain = low[2] + uniform(words, 0.0, 1.0) * (high[2] - low[2])
        traits.heading_gain = low_steering[0] + uniform(words, 0.0, 1.0) * (high_steering[0] - low_steering[0])
        traits.offset_gain = low_steering[1] + uniform(words, 0.0, 1.0) * (high_steering[1] - low_steering[1])
    if traits.kind in (IDM, LINEAR):
        traits.delta = uniform(words, traits.low_delta, traits.high_delta)
