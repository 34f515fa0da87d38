"""States of highway-env's environments that their own episodes seldom come to."""

import numpy as np
from highway_env.road.regulation import RegulatedRoad
from highway_env.vehicle.behavior import IDMVehicle, LinearVehicle
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.objects import Obstacle

from behavexplor.envs.engine.lane_network import lane_indexes

N_OBSTACLES = 2
# length and width [m]; numpy multiplies other widths and adds in one rounding, which changes the last bit of corners
SIZES = [(5.0, 2.0), (5.0, 2.0), (8.0, 4.0), (3.3, 1.0)]
GRID = 2.5  # stations are often its multiples, so that vehicles are side by side, or touch [m]
PARAMETERS = {
    "ACC_MAX": (6.0, 1.0),
    "COMFORT_ACC_MAX": (3.0, 1.7),
    "COMFORT_ACC_MIN": (-5.0, -2.3),
    "DISTANCE_WANTED": (10.0, 2.0),
    "TIME_WANTED": (1.5, 0.4),
    "DELTA": (4.0, 3.6),
    "POLITENESS": (0.0, 0.3, 1.0),
    "LANE_CHANGE_MIN_ACC_GAIN": (0.2, 0.0, -1.0),
    "LANE_CHANGE_MAX_BRAKING_IMPOSED": (2.0, 0.1, 9.0),
    "LANE_CHANGE_DELAY": (1.0, 0.3),
}


def scatter(env, rng, n_steps):
    """Put all vehicles around one place, in any state, with any parameters and with routes of up to some steps."""
    road, indexes = env.road, lane_indexes(env.road.network)
    center = indexes[rng.integers(len(indexes))]
    station = rng.uniform(0, road.network.get_lane(center).length)
    others = [vehicle for vehicle in road.vehicles if vehicle is not env.vehicle][:-N_OBSTACLES]
    others = [one_of(rng, [IDMVehicle, LinearVehicle]).create_from(vehicle) for vehicle in others]
    road.vehicles = others[: len(others) // 2] + [env.vehicle] + others[len(others) // 2 :]
    for vehicle in road.vehicles:
        beside = center if rng.random() < 0.5 else one_of(rng, [center, *road.network.all_side_lanes(center)])
        place(vehicle, one_of(rng, indexes) if rng.random() < 0.2 else beside, station, rng)
        move(vehicle, rng)
        if vehicle is not env.vehicle:
            choose_parameters(vehicle, rng)
        if isinstance(vehicle, ControlledVehicle):
            choose_aims(vehicle, indexes, rng, n_steps)
        if isinstance(road, RegulatedRoad) and isinstance(vehicle, IDMVehicle) and rng.random() < 0.2:
            vehicle.is_yielding, vehicle.yield_timer, vehicle.color = True, 0, None
    if not isinstance(road, RegulatedRoad):  # whose vehicles come and go
        road.objects += [Obstacle(road, [0.0, 0.0]) for _ in range(N_OBSTACLES - len(road.objects))]
    for obstacle in road.objects:
        place(obstacle, one_of(rng, [center, *road.network.all_side_lanes(center)]), station, rng)
    if isinstance(road, RegulatedRoad):
        road.steps = int(rng.integers(100))
    env.define_spaces()  # ranges of the observation depend on the ego's first road


def one_of(rng, values):
    return values[rng.integers(len(values))]


def place(thing, index, station, rng):
    lane = thing.road.network.get_lane(index)
    along = station + rng.normal(0, 25)
    along, aside = (GRID * np.round(along / GRID), 0.0) if rng.random() < 0.5 else (along, rng.normal(0, 1.5))
    thing.position = np.array(lane.position(along, aside), dtype=np.float64)
    turn = rng.normal(0, one_of(rng, [0.1, 0.1, 1.5])) if rng.random() < 0.5 else 0.0
    thing.heading = float(lane.heading_at(along) + turn)
    thing.lane_index = thing.road.network.get_closest_lane_index(thing.position, thing.heading)
    thing.lane = thing.road.network.get_lane(thing.lane_index)


def move(vehicle, rng):
    vehicle.speed = float(one_of(rng, [0.0, 1.5, -3.0, 10.0, rng.uniform(5, 35), rng.uniform(5, 35), 45.0]))
    vehicle.check_collisions = bool(rng.random() < 0.5)
    vehicle.crashed = bool(rng.random() < 0.1)
    vehicle.impact = rng.normal(size=2) if rng.random() < 0.1 else None
    vehicle.action = {"steering": float(rng.normal(0, 0.2)), "acceleration": float(rng.normal(0, 3))}


def choose_parameters(vehicle, rng):
    vehicle.LENGTH, vehicle.WIDTH = one_of(rng, SIZES)
    vehicle.diagonal = np.sqrt(vehicle.LENGTH**2 + vehicle.WIDTH**2)
    vehicle.MIN_SPEED, vehicle.MAX_SPEED = one_of(rng, [(-40.0, 40.0), (0.0, 20.0)])
    if isinstance(vehicle, IDMVehicle):
        for name, values in PARAMETERS.items():
            setattr(vehicle, name, one_of(rng, values))
        vehicle.timer, vehicle.enable_lane_change = float(rng.uniform(0, 1.5)), bool(rng.random() < 0.9)
    if isinstance(vehicle, LinearVehicle):
        vehicle.ACCELERATION_PARAMETERS = rng.uniform(0.1, 2.0, 3)
        vehicle.STEERING_PARAMETERS = rng.uniform(0.1, 2.0, 2)


def choose_aims(vehicle, indexes, rng, n_steps):
    """Choose target lane, target speed and route."""
    network = vehicle.road.network
    beside = [vehicle.lane_index, *network.all_side_lanes(vehicle.lane_index)]
    vehicle.target_lane_index = one_of(rng, indexes if rng.random() < 0.1 else beside)
    if isinstance(vehicle, MDPVehicle):
        vehicle.speed_index = int(rng.integers(len(vehicle.target_speeds)))
        vehicle.target_speed = vehicle.index_to_speed(vehicle.speed_index)
    else:
        vehicle.target_speed = float(rng.uniform(0, 35))
    kind = rng.integers(4)
    vehicle.route = None if kind == 0 else []
    if kind > 1:
        vehicle.plan_route_to(one_of(rng, indexes)[1])
        del vehicle.route[n_steps:]
    if kind > 2:
        start, *others = vehicle.route
        vehicle.route = [(*start[:2], one_of(rng, [None, *(index[2] for index in beside)])), *others]
