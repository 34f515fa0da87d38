"""The `Scene` and `Kinematics` observations of all egos, computed from arrays."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.data import scene
from behavexplor.data.npc_motion import ACCELERATION, HEADING, SPEED, X, Y
from behavexplor.data.vehicle_sizes import EGO_SIZE
from behavexplor.envs.kinematics import FEATURES, RELATIVE, Kinematics
from behavexplor.envs.vector.lanes import closest_lane, lane_coordinates, lane_heading, wrap_to_pi
from behavexplor.envs.vector.slots import N_NPCS, ROUTE, ROUTE_POSITION, Slots
from behavexplor.envs.vector.world import World
from behavexplor.jit import kernel, kernel_in_place, kernel_inner

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

PRESENCE, POS_X, POS_Y, VEL_X, VEL_Y, ANGLE, COS_H, SIN_H, COS_D, SIN_D, LONG_OFF, LAT_OFF, _ = range(len(FEATURES))


class View(NamedTuple):
    """The options of a Kinematics observation.

    Attributes:
        features: code of each feature, its index in `behavexplor.envs.kinematics.FEATURES`, shape (features,).
        relative: whether each feature is relative to the ego, shape (features,).
        low: lower end of each feature's range, 0 if it is not normalized, shape (features,).
        width: width of each feature's range, 0 if it is not normalized, shape (features,).
        clip: whether normalized values are clipped.
        see_behind: whether vehicles behind the ego are observed.
        observe_intentions: whether the destinations of other vehicles are observed.
        distance: greatest distance at which vehicles are observed [m].
    """

    features: Ints
    relative: Bools
    low: Floats
    width: Floats
    clip: bool
    see_behind: bool
    observe_intentions: bool
    distance: float


def make_view(observation: Kinematics) -> View:
    """Return the options of an observation that was computed at least once, so that its default ranges are set."""
    ranges = (observation.features_range or {}) if observation.normalize else {}
    spans = np.array([ranges.get(feature, (0.0, 0.0)) for feature in observation.features], dtype=np.float64)
    return View(
        features=np.array([FEATURES.index(feature) for feature in observation.features]),
        relative=np.array([feature in RELATIVE and not observation.absolute for feature in observation.features]),
        low=spans[:, 0].copy(),
        width=spans[:, 1] - spans[:, 0],
        clip=bool(observation.clip),
        see_behind=bool(observation.see_behind),
        observe_intentions=bool(observation.observe_intentions),
        distance=float(observation.env.PERCEPTION_DISTANCE),
    )


@kernel_in_place
def observe_scene(slots: Slots, chosen: Bools, observations: Floats) -> None:
    """Fill the `Scene` observations of the chosen slots, shape (B, 1 + N, 8); see `behavexplor.data.scene`."""
    for b in range(len(chosen)):
        if not chosen[b]:
            continue
        observations[b] = 0.0
        ego = slots.ego[b]
        for i in range(1 + slots.numbers[b, N_NPCS]):
            row = observations[b, i]
            source = ego if i == 0 else slots.npc[b, i - 1]
            row[scene.PRESENT] = 1.0
            row[scene.X], row[scene.Y], row[scene.HEADING] = source[X], source[Y], source[HEADING]
            row[scene.SPEED], row[scene.ACCELERATION] = source[SPEED], source[ACCELERATION]
            row[scene.LENGTH], row[scene.WIDTH] = slots.size[b, i, 0], slots.size[b, i, 1]


@kernel
def observe_kinematics(world: World, slots: Slots, view: View, chosen: Bools, observations: Singles) -> None:
    """Fill the Kinematics observations of the chosen slots, shape (B, vehicles_count, features)."""
    lanes, ego, npc = world.network.lanes, slots.ego, slots.npc
    order, gaps = np.empty(npc.shape[1], dtype=np.int64), np.empty(npc.shape[1])
    origin = np.zeros(len(view.features))
    for b in range(len(chosen)):
        if not chosen[b]:
            continue
        observations[b] = 0.0
        n_seen = _sort_seen(lanes, ego, npc, b, slots.numbers[b, N_NPCS], view, order, gaps)
        for row in range(min(1 + n_seen, observations.shape[1])):
            i = order[row - 1]
            if row == 0:
                x, y, heading, speed = ego[b, X], ego[b, Y], ego[b, HEADING], ego[b, SPEED]
                end_x, end_y = world.ego_end[0], world.ego_end[1]
                knows_end = slots.numbers[b, ROUTE_POSITION] < len(world.network.route)  # completed steps are dropped
            else:
                x, y, heading, speed = npc[b, i, X], npc[b, i, Y], npc[b, i, HEADING], npc[b, i, SPEED]
                route = slots.npc_numbers[b, i, ROUTE]
                end_x, end_y = world.npc_ends[route, 0], world.npc_ends[route, 1]
                knows_end = view.observe_intentions
            if not knows_end:
                end_x, end_y = x, y
            for j in range(len(view.features)):
                value = _value(lanes, view.features[j], x, y, heading, speed, end_x, end_y)
                if row == 0:
                    origin[j] = value
                elif view.relative[j]:
                    value -= origin[j]
                observations[b, row, j] = _normalized(value, view.low[j], view.width[j], view.clip)


@kernel_inner
def _sort_seen(
    lanes: Floats, ego: Floats, npc: Floats, b: int, n_npcs: int, view: View, order: Ints, gaps: Floats
) -> int:
    """Fill `order` with the observed NPCs of slot b, the nearest along the ego's lane first. Return their number."""
    lane = closest_lane(lanes, ego[b, X], ego[b, Y], ego[b, HEADING])
    own, _ = lane_coordinates(lanes, lane, ego[b, X], ego[b, Y])
    n = 0
    for i in range(n_npcs):
        dx, dy = npc[b, i, X] - ego[b, X], npc[b, i, Y] - ego[b, Y]
        station, _ = lane_coordinates(lanes, lane, npc[b, i, X], npc[b, i, Y])
        ahead = station - own
        if not (math.sqrt(dx * dx + dy * dy) < view.distance and (view.see_behind or -2 * EGO_SIZE[0] < ahead)):
            continue
        place = n
        while place > 0 and gaps[place - 1] > abs(ahead):
            gaps[place], order[place] = gaps[place - 1], order[place - 1]
            place -= 1
        gaps[place], order[place] = abs(ahead), i
        n += 1
    return n


@kernel_inner
def _normalized(value: float, low: float, width: float, clip: bool) -> float:
    """Map a value from its range to [-1, 1], if it has a range."""
    if width == 0.0:
        return value
    value = -1 + (value - low) * 2 / width
    return min(max(value, -1.0), 1.0) if clip else value


@kernel_inner
def _value(
    lanes: Floats, feature: int, x: float, y: float, heading: float, speed: float, end_x: float, end_y: float
) -> float:
    """Compute a feature of a vehicle.

    The end point of its route is its own position if its destination is unknown.
    """
    if feature <= POS_Y:
        return 1.0 if feature == PRESENCE else x if feature == POS_X else y
    if feature <= VEL_Y:
        return speed * (math.cos(heading) if feature == VEL_X else math.sin(heading))
    if feature <= SIN_H:
        return heading if feature == ANGLE else math.cos(heading) if feature == COS_H else math.sin(heading)
    if feature <= SIN_D:
        dx, dy = end_x - x, end_y - y
        distance = math.sqrt(dx * dx + dy * dy)
        return 0.0 if distance == 0.0 else (dx if feature == COS_D else dy) / distance
    return _lane_offset(lanes, feature, x, y, heading)


@kernel_inner
def _lane_offset(lanes: Floats, feature: int, x: float, y: float, heading: float) -> float:
    """Compute the station [m], offset [m] or angle [rad] of a vehicle in its closest lane."""
    lane = closest_lane(lanes, x, y, heading)
    station, offset = lane_coordinates(lanes, lane, x, y)
    if feature == LONG_OFF:
        return station
    return offset if feature == LAT_OFF else wrap_to_pi(heading - lane_heading(lanes, lane, station))
