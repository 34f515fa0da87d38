"""The state of one slot: an episode as it stands."""

from typing import NamedTuple

import numpy as np
from highway_env.road.road import LaneIndex, RoadNetwork

from behavexplor.envs.engine.lane_network import road_numbers
from behavexplor.envs.engine.state import NO_ROUTE, Records, Slots
from behavexplor.envs.stock.conversion import make_route

_NOT_COMPARED = frozenset({"number", "n_numbered", "route_position", "route_length"})
_PRECISION = 1e-9  # numpy and the C library may differ in the last bit


class SlotState(NamedTuple):
    """A copy of a slot with n vehicles and obstacles.

    Attributes:
        episode: shape () of `behavexplor.envs.engine.state.EPISODE`.
        vehicles: shape (n,) of `VEHICLE`.
        traits: shape (n,) of `TRAITS`.
        routes: shape (n, steps) of `ROUTE_STEP`.
    """

    episode: Records
    vehicles: Records
    traits: Records
    routes: Records

    def ego_route(self, network: RoadNetwork) -> list[LaneIndex]:
        """Return the lanes of what is left of the ego's route; none if it has no route."""
        ego = int(self.episode["ego"])
        return make_route(self.vehicles[ego], self.routes[ego], list(road_numbers(network))) or []

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
    """Return whether two episodes stand alike. The numbers of their vehicles may differ."""
    if one.vehicles.shape != other.vehicles.shape:
        return False
    pairs = ((one.episode, other.episode), (one.vehicles, other.vehicles), (one.traits, other.traits))
    return all(_are_close(*pair) for pair in pairs) and _have_same_routes(one, other)


def _are_close(one: Records, other: Records) -> bool:
    names = [name for name in one.dtype.names or () if name not in _NOT_COMPARED]
    return all(np.allclose(one[name], other[name], rtol=0.0, atol=_PRECISION) for name in names)


def _have_same_routes(one: SlotState, other: SlotState) -> bool:
    return all(_rest(one, i) == _rest(other, i) for i in range(len(one.vehicles)))


def _rest(state: SlotState, i: int) -> list[tuple[int, int]] | None:
    """Return what is left of the route of vehicle i; None if it has no route."""
    vehicle = state.vehicles[i]
    if vehicle["route_length"] == NO_ROUTE:
        return None
    rest: list[tuple[int, int]] = state.routes[i, vehicle["route_position"] : vehicle["route_length"]].tolist()
    return rest
