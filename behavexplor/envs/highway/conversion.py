"""Copy the state of a highway-env environment into a slot; and copy a slot's state, to compare it with another's."""

import math
from typing import Any, NamedTuple

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.lane import AbstractLane
from highway_env.road.road import LaneIndex, RoadNetwork
from highway_env.vehicle.objects import RoadObject

from behavexplor.data.array_types import Floats
from behavexplor.envs.engine.lane_network import lane_indexes, road_numbers
from behavexplor.envs.engine.state import (
    IDM,
    LINEAR,
    MDP,
    NO_LANE,
    NO_ROUTE,
    OBSTACLE,
    SAME_NUMBER,
    VEHICLE,
    Records,
    Slots,
    Vehicle,
)
from behavexplor.envs.engine.vehicle_parameters import kind_of, traits_of
from behavexplor.envs.engine.world import EGO, World
from behavexplor.errors import InputError

# Numbers tell only in which order vehicles appeared. What is left of the routes is compared instead of their indices.
_NOT_COMPARED = frozenset({"number", "n_numbered", "route_position", "route_length"})
_PRECISION = 1e-9  # numpy and the C library may differ in the last bit


def load_state(env: AbstractEnv, world: World, slots: Slots, b: int) -> None:
    """Copy the present state of an environment into slot b.

    The environment has no wrappers, and has the road and rules of `world`.

    Raises:
        InputError: if the environment has vehicles that the engine does not know or too many for the slot, a vehicle
            with other target speeds than those of `world`, or a route that is too long or leaves the road network.
    """
    road, episode = env.road, slots.episodes[b]
    things = [*road.vehicles, *road.objects]
    if len(things) > slots.vehicles.shape[1]:
        raise InputError(
            f"The environment has {len(things)} vehicles and obstacles, but a slot holds {slots.vehicles.shape[1]}; "
            f"make slots with more places"
        )
    episode.n_vehicles = len(road.vehicles)
    episode.n_obstacles = len(road.objects)
    episode.n_numbered = len(things)
    episode.ego = road.vehicles.index(env.vehicle)
    episode.frames = env.steps
    episode.time = env.time
    episode.road_frames = getattr(road, "steps", 0)
    episode.n_side_lanes = _n_side_lanes(env)
    lanes = {index: lane for lane, index in enumerate(lane_indexes(road.network))}
    roads = road_numbers(road.network)
    classes = {type(thing) for thing in things}
    kinds = {cls: kind_of(cls) for cls in classes}  # once for each class, because `kind_of` looks through its methods
    for i, thing in enumerate(things):
        kind = kinds[type(thing)]
        slots.traits[b, i] = traits_of(thing, kind)
        slots.vehicles[b, i] = np.zeros((), VEHICLE)
        slots.vehicles[b, i].number = i
        _load_pose(slots.vehicles[b, i], thing, lanes)
        if kind != OBSTACLE:
            _load_commands(slots.vehicles[b, i], thing)
        if kind in (MDP, IDM, LINEAR):
            _load_targets(slots.vehicles[b, i], thing, lanes, world.speeds)
            _load_route(slots.vehicles[b, i], slots.routes[b, i], thing.route, roads)
    ego = slots.traits[b, episode.ego]  # its range of speeds may be that of the actions instead of that of its class
    ego.min_speed = world.templates[EGO].min_speed
    ego.max_speed = world.templates[EGO].max_speed


def _load_pose(vehicle: Vehicle, thing: RoadObject, lanes: dict[LaneIndex, int]) -> None:
    vehicle.x, vehicle.y = thing.position
    vehicle.heading = thing.heading
    vehicle.cos, vehicle.sin = math.cos(thing.heading), math.sin(thing.heading)
    vehicle.speed = thing.speed
    vehicle.lane = lanes[tuple(thing.lane_index)]
    vehicle.target_lane = NO_LANE
    vehicle.crashed = thing.crashed


def _load_commands(vehicle: Vehicle, thing: Any) -> None:
    vehicle.steering = thing.action["steering"]
    vehicle.acceleration = thing.action["acceleration"]
    if thing.impact is not None:
        vehicle.impact_x, vehicle.impact_y = thing.impact
        vehicle.has_impact = True


def _load_targets(vehicle: Vehicle, thing: Any, lanes: dict[LaneIndex, int], speeds: Floats) -> None:
    if not np.array_equal(getattr(thing, "target_speeds", speeds), speeds):
        raise InputError(
            f"A vehicle has the target speeds {thing.target_speeds}, but those of the actions are {speeds}; give all "
            f"vehicles the same target_speeds"
        )
    vehicle.target_lane = lanes[tuple(thing.target_lane_index)]
    vehicle.target_speed = thing.target_speed
    vehicle.speed_index = getattr(thing, "speed_index", 0)
    vehicle.timer = getattr(thing, "timer", 0.0)
    vehicle.is_yielding = getattr(thing, "is_yielding", False)


def _load_route(
    vehicle: Vehicle, steps: Records, route: list[LaneIndex] | None, roads: dict[tuple[str, str], int]
) -> None:
    lanes = route or []
    vehicle.route_position = 0
    vehicle.route_length = NO_ROUTE if route is None else len(route)
    if len(lanes) > len(steps):
        raise InputError(f"A route has {len(lanes)} steps, but a slot holds {len(steps)}; make longer ones")
    for step, (origin, target, number) in zip(steps, lanes, strict=False):  # a slot has room for more
        if (origin, target) not in roads:
            raise InputError(f"A route has the road {(origin, target)}, which the road network does not have")
        step.road = roads[origin, target]
        step.number = SAME_NUMBER if number is None else number


def _n_side_lanes(env: AbstractEnv) -> int:
    """Return on how many lanes the default ranges of the observation are based: those of the ego's first road."""
    ranges = getattr(env.observation_type, "features_range", None)
    if ranges and "y" in ranges:
        n_lanes: int = round(ranges["y"][1] / AbstractLane.DEFAULT_WIDTH)
        return n_lanes
    return len(env.road.network.all_side_lanes(env.vehicle.lane_index))


class SlotState(NamedTuple):
    """A copy of a slot with n vehicles and obstacles."""

    episode: Records  # shape () of `behavexplor.envs.engine.state.EPISODE`
    vehicles: Records  # shape (n,) of `VEHICLE`
    traits: Records  # shape (n,) of `TRAITS`
    routes: Records  # shape (n, steps) of `ROUTE_STEP`

    def ego_route(self, network: RoadNetwork) -> list[LaneIndex]:
        """Return the lanes of what is left of the ego's route; an empty list if it has no route."""
        rest = _rest(self, int(self.episode["ego"])) or []
        ends = list(road_numbers(network))
        return [(*ends[road], None if number == SAME_NUMBER else number) for road, number in rest]

    def sizes(self) -> dict[int, tuple[float, float]]:
        """Return length and width of each vehicle and obstacle by its number [m], in the order of the slot."""
        sizes = zip(self.traits["length"].tolist(), self.traits["width"].tolist(), strict=True)
        return dict(zip(self.vehicles["number"].tolist(), sizes, strict=True))


def slot_state(slots: Slots, b: int) -> SlotState:
    """Return a copy of slot b."""
    n = int(slots.episodes[b]["n_vehicles"] + slots.episodes[b]["n_obstacles"])
    return SlotState(
        slots.episodes[b].copy(), slots.vehicles[b, :n].copy(), slots.traits[b, :n].copy(), slots.routes[b, :n].copy()
    )


def are_alike(one: SlotState, other: SlotState) -> bool:
    """Return whether two slots are in the same state, but for the numbers of their vehicles."""
    if one.vehicles.shape != other.vehicles.shape:
        return False
    pairs = ((one.episode, other.episode), (one.vehicles, other.vehicles), (one.traits, other.traits))
    have_same_routes = all(_rest(one, i) == _rest(other, i) for i in range(len(one.vehicles)))
    return have_same_routes and all(_are_close(a, b) for a, b in pairs)


def _are_close(one: Records, other: Records) -> bool:
    names = [name for name in one.dtype.names or () if name not in _NOT_COMPARED]
    return all(np.allclose(one[name], other[name], rtol=0.0, atol=_PRECISION) for name in names)


def _rest(state: SlotState, i: int) -> list[tuple[int, int]] | None:
    """Return road and lane of each step left of the route of vehicle i; None if it has no route."""
    vehicle = state.vehicles[i]
    if vehicle["route_length"] == NO_ROUTE:
        return None
    rest: list[tuple[int, int]] = state.routes[i, vehicle["route_position"] : vehicle["route_length"]].tolist()
    return rest
