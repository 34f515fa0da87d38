"""Wide traffic: other vehicles anywhere around the ego, with other speeds and other manners than an environment's own.

An environment's own traffic always starts in the same way: on the highway, all vehicles are ahead of the ego. In wide
traffic, the same vehicles are placed by draws of the lane, the station, the speed, the target speed and the parameters
of the car-following and lane-change models; one that finds no place is left out. The lane and the speed of the ego are
drawn as well. A follower in a lane starts at no less than the distance that it wants, and no other vehicle starts
slower than the ego can choose to drive, so no scene is lost from its start.
"""

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.lane import AbstractLane
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle

from behavexplor.errors import InputError

REACH: Final = 120.0  # least reach of the traffic, to both sides of the ego [m]
ASIDE: Final = 1.0  # between two vehicles in different lanes, beyond half their lengths [m]
ATTEMPTS: Final = 20  # places drawn for a vehicle before it is left out
SPEED_SHARES: Final = (0.6, 1.3)  # of the speed in the environment's own traffic
PARAMETERS: Final = {  # ranges of the parameters of `IDMVehicle`, around highway-env's 1.5 s, 0, 4 and 0.2 m/s2
    "TIME_WANTED": (0.8, 2.2),
    "POLITENESS": (0.0, 0.5),
    "DELTA": (3.5, 4.5),
    "LANE_CHANGE_MIN_ACC_GAIN": (0.1, 0.5),
}
_MAKERS: Final = ("_create_vehicles", "_make_vehicles")  # methods of highway-env that place the vehicles


def widen(env: AbstractEnv) -> None:
    """Give an environment, which has been reset before, wide traffic from its next reset on.

    Raises:
        InputError: if the environment places its vehicles in an unknown way, or begins without other vehicles that
            could be placed elsewhere.
    """
    name = next((name for name in _MAKERS if hasattr(env, name)), None)
    if name is None:
        raise InputError(f"{type(env).__name__} has no wide traffic, since it places its vehicles in its own way")
    if not any(isinstance(vehicle, IDMVehicle) for vehicle in env.road.vehicles):
        raise InputError(
            f"{type(env).__name__} has no wide traffic in this configuration, since it begins without other vehicles "
            f"that drive by highway-env's car-following model"
        )
    own: Callable[..., None] = getattr(env, name)

    def make_widely(*arguments: Any, **keywords: Any) -> None:
        own(*arguments, **keywords)
        _replace_traffic(env)

    setattr(env, name, make_widely)


def _replace_traffic(env: AbstractEnv) -> None:
    """Place the ego and all other vehicles of a new scene again."""
    road, ego = env.road, env.vehicle
    others = [vehicle for vehicle in road.vehicles if vehicle is not ego]
    routes = [vehicle.route for vehicle in others if getattr(vehicle, "route", None)]
    spread = max((math.dist(vehicle.position, ego.position) for vehicle in others), default=0.0)
    reach = max(REACH, spread / 2)  # on both sides of the ego, so that the traffic is as dense as the environment's own
    road.vehicles[:] = [ego]
    _place_ego(env, ego)
    for vehicle in others:
        if isinstance(vehicle, IDMVehicle):
            _place_vehicle(env, vehicle, routes, reach)
        else:
            road.vehicles.append(vehicle)


def _place_ego(env: AbstractEnv, ego: Vehicle) -> None:
    rng, network = env.np_random, env.road.network
    origin, target, _ = ego.lane_index
    beside = network.graph[origin][target]
    lane = beside[int(rng.integers(len(beside)))]
    station, _ = lane.local_coordinates(ego.position)
    speed = ego.speed * rng.uniform(*SPEED_SHARES)
    _move(ego, lane, station, min(speed, ego.MAX_SPEED))
    if isinstance(ego, MDPVehicle):
        ego.speed_index = ego.speed_to_index(ego.speed)
        ego.target_speed = ego.index_to_speed(ego.speed_index)


def _place_vehicle(env: AbstractEnv, vehicle: IDMVehicle, routes: list[Any], reach: float) -> None:
    """Draw the manners of a vehicle and a place for it; leave it out if there is none."""
    rng, own_speed = env.np_random, max(vehicle.target_speed, vehicle.speed)
    for name, (low, high) in PARAMETERS.items():
        setattr(vehicle, name, rng.uniform(low, high))
    target_speed = _share_of(own_speed, env)
    destination = int(rng.integers(len(routes))) if routes else 0
    for _ in range(ATTEMPTS):
        if not _try_place(env, vehicle, own_speed, reach):
            continue
        vehicle.target_speed = target_speed
        if routes:
            vehicle.plan_route_to(routes[destination][-1][1])
        env.road.vehicles.append(vehicle)
        return


def _try_place(env: AbstractEnv, vehicle: Vehicle, speed: float, reach: float) -> bool:
    """Draw a place for a vehicle and move it there. Return whether it may start there."""
    rng, near = env.np_random, _lanes_near(env, reach)
    lane, low, high = near[int(rng.integers(len(near)))]
    station = rng.uniform(low, high)
    _move(vehicle, lane, station, _share_of(speed, env))
    return all(_has_room(vehicle, other) for other in env.road.vehicles)


def _share_of(speed: float, env: AbstractEnv) -> float:
    """Draw a speed around another one, and no less than the least speed that the ego can choose [m/s]."""
    least = min(getattr(env.vehicle, "target_speeds", [0.0]))
    return float(max(speed * env.np_random.uniform(*SPEED_SHARES), least))


def _lanes_near(env: AbstractEnv, reach: float) -> list[tuple[AbstractLane, float, float]]:
    """Return the lanes that come near the ego, each with the first and the last station that is near [m]."""
    found = []
    for lane in env.road.network.lanes_list():
        middle, _ = lane.local_coordinates(env.vehicle.position)
        low, high = max(middle - reach, 0.0), min(middle + reach, lane.length)
        if low < high and np.abs(lane.position((low + high) / 2, 0.0) - env.vehicle.position).max() < 2 * reach:
            found.append((lane, low, high))
    return found


def _move(vehicle: Vehicle, lane: AbstractLane, station: float, speed: float) -> None:
    """Put a vehicle on a lane, as its constructor would."""
    vehicle.position = lane.position(station, 0.0)
    vehicle.heading = lane.heading_at(station)
    vehicle.speed = speed
    vehicle.lane_index = vehicle.road.network.get_closest_lane_index(vehicle.position, vehicle.heading)
    vehicle.lane = vehicle.road.network.get_lane(vehicle.lane_index)
    if hasattr(vehicle, "target_lane_index"):
        vehicle.target_lane_index = vehicle.lane_index


def _has_room(vehicle: Vehicle, other: Vehicle) -> bool:
    """Return whether two vehicles may start beside or behind each other."""
    apart = math.dist(vehicle.position, other.position)
    if vehicle.lane_index != other.lane_index:
        return bool(apart > (vehicle.LENGTH + other.LENGTH) / 2 + ASIDE)
    stations = [vehicle.lane.local_coordinates(each.position)[0] for each in (vehicle, other)]
    follower, leader = (vehicle, other) if stations[0] < stations[1] else (other, vehicle)
    return bool(abs(stations[0] - stations[1]) > _wanted_gap(follower, leader))


def _wanted_gap(follower: Vehicle, leader: Vehicle) -> float:
    """Return the distance of centers that a follower wants by highway-env's car-following model [m].

    At a smaller one, it would brake at once, and soon be slower than the ego can choose to drive.
    """
    closing = max(follower.speed - leader.speed, 0.0)
    braking = 2 * math.sqrt(-IDMVehicle.COMFORT_ACC_MAX * IDMVehicle.COMFORT_ACC_MIN)
    time = getattr(follower, "TIME_WANTED", IDMVehicle.TIME_WANTED)
    return float(IDMVehicle.DISTANCE_WANTED + follower.speed * (time + closing / braking))
