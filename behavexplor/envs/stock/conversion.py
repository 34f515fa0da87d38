"""Copy the state of a highway-env environment into a slot, and back."""

import math
from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import LaneIndex
from highway_env.vehicle.objects import RoadObject

from behavexplor.envs.stock.lane_network import lane_indexes, road_numbers
from behavexplor.envs.stock.records import Records
from behavexplor.envs.stock.state import (
    IDM,
    LINEAR,
    MDP,
    NO_LANE,
    NO_ROUTE,
    OBSTACLE,
    SAME_NUMBER,
    VEHICLE,
    Slots,
    Vehicle,
)
from behavexplor.envs.stock.traits import kind_of, traits_of
from behavexplor.envs.stock.world import EGO, World
from behavexplor.errors import InputError


def load(env: AbstractEnv, world: World, slots: Slots, b: int) -> None:
    """Copy the present state of an environment into slot b.

    Args:
        env: a highway-env environment, without wrappers, with the road and the rules of `world`.
        world: the road and rules.
        slots: the slots, changed in place.
        b: the slot.

    Raises:
        InputError: if the environment has vehicles that the engine does not know, or too many for the slot.
    """
    road, episode = env.road, slots.episodes[b]
    things = [*road.vehicles, *road.objects]
    if len(things) > slots.vehicles.shape[1]:
        raise InputError(
            f"The environment has {len(things)} vehicles and obstacles, but a slot holds {slots.vehicles.shape[1]}; "
            f"make slots with more places"
        )
    episode.n_vehicles, episode.n_obstacles = len(road.vehicles), len(road.objects)
    episode.ego = road.vehicles.index(env.vehicle)
    episode.frames, episode.time, episode.road_frames = env.steps, env.time, getattr(road, "steps", 0)
    lanes = {index: lane for lane, index in enumerate(lane_indexes(road.network))}
    roads = road_numbers(road.network)
    for i, thing in enumerate(things):
        kind = kind_of(type(thing))
        slots.traits[b, i] = traits_of(thing, kind)
        slots.vehicles[b, i] = np.zeros((), VEHICLE)
        _load_pose(slots.vehicles[b, i], thing, lanes)
        if kind != OBSTACLE:
            _load_commands(slots.vehicles[b, i], thing)
        if kind in (MDP, IDM, LINEAR):
            _load_targets(slots.vehicles[b, i], thing, lanes)
            _load_route(slots.vehicles[b, i], slots.routes[b, i], thing.route, roads)
    ego = world.templates[EGO]
    slots.traits[b, episode.ego].min_speed, slots.traits[b, episode.ego].max_speed = ego.min_speed, ego.max_speed


def _load_pose(vehicle: Vehicle, thing: RoadObject, lanes: dict[LaneIndex, int]) -> None:
    (vehicle.x, vehicle.y), vehicle.heading, vehicle.speed = thing.position, thing.heading, thing.speed
    vehicle.cos, vehicle.sin = math.cos(thing.heading), math.sin(thing.heading)
    vehicle.lane, vehicle.target_lane = lanes[tuple(thing.lane_index)], NO_LANE
    vehicle.crashed = thing.crashed


def _load_commands(vehicle: Vehicle, thing: Any) -> None:
    vehicle.steering, vehicle.acceleration = thing.action["steering"], thing.action["acceleration"]
    if thing.impact is not None:
        (vehicle.impact_x, vehicle.impact_y), vehicle.has_impact = thing.impact, True


def _load_targets(vehicle: Vehicle, thing: Any, lanes: dict[LaneIndex, int]) -> None:
    vehicle.target_lane, vehicle.target_speed = lanes[tuple(thing.target_lane_index)], thing.target_speed
    vehicle.speed_index, vehicle.timer = getattr(thing, "speed_index", 0), getattr(thing, "timer", 0.0)
    vehicle.is_yielding = getattr(thing, "is_yielding", False)


def _load_route(
    vehicle: Vehicle, steps: Records, route: list[LaneIndex] | None, roads: dict[tuple[str, str], int]
) -> None:
    vehicle.route_position, vehicle.route_length = 0, NO_ROUTE if route is None else len(route)
    if len(route or []) > len(steps):
        raise InputError(f"A route has {len(route or [])} steps, but a slot holds {len(steps)}; make longer ones")
    for step, (origin, target, number) in zip(steps, route or [], strict=False):
        if (origin, target) not in roads:
            raise InputError(f"A route has the road {(origin, target)}, which the road network does not have")
        step.road, step.number = roads[origin, target], SAME_NUMBER if number is None else number
