"""Geometry of lanes: coordinates, headings, distances and the closest lane; and where vehicles are on lanes.

Operations follow highway-env's own order, so that results are equal to the last bits.
"""

import math
from typing import Final

from highway_env.road.lane import AbstractLane

from behavexplor.envs.engine.lane_network import ALL_NEAR, CIRCULAR, NEAR_LIMIT, SINE, STRAIGHT, Lane, Network
from behavexplor.envs.engine.state import Scene, Vehicle
from behavexplor.jit import kernel_inner

VEHICLE_LENGTH: Final = float(AbstractLane.VEHICLE_LENGTH)  # highway-env extends lanes by this length [m]
SLACK: Final = 1e-9  # more than the rounding errors of a lane's least distance [m]


@kernel_inner
def wrap_to_pi(angle: float) -> float:
    """Wrap an angle to [-pi, pi)."""
    turned = angle + math.pi
    if 0 <= turned < 2 * math.pi:  # these three cases need no division, and have the same result
        return turned - math.pi
    if -2 * math.pi < turned < 0:
        return turned + 2 * math.pi - math.pi
    if 2 * math.pi <= turned < 4 * math.pi:
        return turned - 2 * math.pi - math.pi
    wrapped: float = (turned % (2 * math.pi)) - math.pi
    return wrapped


@kernel_inner
def lane_coordinates(lane: Lane, x: float, y: float) -> tuple[float, float]:
    """Compute the station and the offset of a point [m]: `local_coordinates`."""
    if lane.kind == STRAIGHT:
        dx, dy = x - lane.x, y - lane.y
        return dx * lane.cos + dy * lane.sin, dx * -lane.sin + dy * lane.cos
    return _coordinates_on_curve(lane, x, y)


@kernel_inner
def _coordinates_on_curve(lane: Lane, x: float, y: float) -> tuple[float, float]:
    dx, dy = x - lane.x, y - lane.y
    if lane.kind == CIRCULAR:
        start = lane.phase
        phase = start + wrap_to_pi(math.atan2(dy, dx) - start)
        station = lane.turn * (phase - start) * lane.radius
        return station, lane.turn * (lane.radius - math.sqrt(dx * dx + dy * dy))
    station = dx * lane.cos + dy * lane.sin
    offset = dx * -lane.sin + dy * lane.cos
    return station, offset - lane.amplitude * math.sin(lane.pulsation * station + lane.phase)


@kernel_inner
def lane_heading(lane: Lane, station: float) -> float:
    """Compute the heading at a station [rad]: `heading_at`."""
    if lane.kind == CIRCULAR:
        return float(lane.turn * station / lane.radius + lane.phase + math.pi / 2 * lane.turn)
    if lane.kind == SINE:
        slope = lane.amplitude * lane.pulsation * math.cos(lane.pulsation * station + lane.phase)
        return float(lane.heading + math.atan(slope))
    return float(lane.heading)


@kernel_inner
def lane_point(lane: Lane, station: float) -> tuple[float, float]:
    """Compute the point of the center line at a station [m]: `position` with a lateral coordinate of 0."""
    if lane.kind == CIRCULAR:
        phase = lane.turn * station / lane.radius + lane.phase
        return lane.x + lane.radius * math.cos(phase), lane.y + lane.radius * math.sin(phase)
    offset = 0.0
    if lane.kind == SINE:
        offset = lane.amplitude * math.sin(lane.pulsation * station + lane.phase)
    x = lane.x + station * lane.cos + offset * -lane.sin
    return x, lane.y + station * lane.sin + offset * lane.cos


@kernel_inner
def lane_distance(lane: Lane, x: float, y: float) -> float:
    """Compute the distance of a point: its offset plus its distance beyond either end [m]: `distance`."""
    return _distance(lane, *lane_coordinates(lane, x, y))


@kernel_inner
def is_on_lane(lane: Lane, station: float, offset: float, margin: float) -> bool:
    """Return whether a point with these coordinates [m] is on the lane: `on_lane`."""
    is_beside = abs(offset) <= lane.width / 2 + margin
    return bool(is_beside and station >= -VEHICLE_LENGTH and station < lane.length + VEHICLE_LENGTH)


@kernel_inner
def may_be_on_lane(lane: Lane, x: float, y: float, margin: float) -> bool:
    """Return whether a point may be on the lane. False is certain, and saves the exact coordinates."""
    if lane.kind == STRAIGHT:  # its exact coordinates take no longer
        return True
    dx, dy = x - lane.x, y - lane.y
    reach = lane.width / 2 + margin
    if lane.kind == SINE:
        return bool(abs(dx * -lane.sin + dy * lane.cos) - abs(lane.amplitude) <= reach + SLACK)
    if _is_off_circle(lane, dx, dy, reach):
        return False
    return _least_distance_beyond_arc(lane, dx, dy, math.sqrt(dx * dx + dy * dy)) <= VEHICLE_LENGTH + SLACK


@kernel_inner
def is_on_road(network: Network, vehicle: Vehicle) -> bool:
    """Return whether a vehicle is on its lane: `RoadObject.on_road`."""
    lane = network.lanes[vehicle.lane]
    station, offset = lane_coordinates(lane, vehicle.x, vehicle.y)
    return is_on_lane(lane, station, offset, 0.0)


@kernel_inner
def is_reachable(lane: Lane, x: float, y: float) -> bool:
    """Return whether a vehicle at this point may change to the lane: `is_reachable_from`."""
    if lane.is_forbidden:
        return False
    station, offset = lane_coordinates(lane, x, y)
    return bool(abs(offset) <= 2 * lane.width and station >= 0 and station < lane.length + VEHICLE_LENGTH)


@kernel_inner
def is_after_end(lane: Lane, station: float) -> bool:
    """Return whether a station is so near the end that highway-env looks for the next lane: `after_end`."""
    return bool(station > lane.length - VEHICLE_LENGTH / 2)


@kernel_inner
def closest_lane(network: Network, likely: int, x: float, y: float, heading: float) -> tuple[int, float, float]:
    """Return the lane that is closest in position and heading, and the coordinates on it [m].

    The lane is that of `RoadNetwork.get_closest_lane_index`: if several are equally close, the first of them. `likely`
    is a lane that is probably close. It saves time, but does not change the result.
    """
    best, coordinates = likely, lane_coordinates(network.lanes[likely], x, y)
    likely_distance = _distance(network.lanes[likely], *coordinates)
    # at a point so near the lane, only those in its `near` can be closer
    near = network.lanes[likely].near if likely_distance <= NEAR_LIMIT else ALL_NEAR
    if _is_alone(network, near, likely, x, y, likely_distance + math.pi):  # at any heading
        return best, *coordinates
    nearest = _distance_with_heading(network.lanes[likely], *coordinates, heading)
    for i in range(len(network.lanes)):
        lane = network.lanes[i]
        is_near, near = near & 1, near >> 1  # the lowest bit is that of lane i
        if not is_near or i == likely or is_farther(lane, x, y, nearest):
            continue
        found = lane_coordinates(lane, x, y)
        distance = _distance_with_heading(lane, *found, heading)
        if distance < nearest or (distance == nearest and i < best):
            best, nearest, coordinates = i, distance, found
    return best, *coordinates


@kernel_inner
def _is_alone(network: Network, near: int, lane: int, x: float, y: float, limit: float) -> bool:
    """Return whether all other lanes are certainly farther from a point than a limit [m].

    Only those are looked at that have a bit in `near`, as in `Lane.near`.
    """
    for i in range(len(network.lanes)):
        is_near, near = near & 1, near >> 1  # the lowest bit is that of lane i
        if is_near and i != lane and not is_farther(network.lanes[i], x, y, limit):
            return False
    return True


@kernel_inner
def _distance(lane: Lane, station: float, offset: float) -> float:
    return float(abs(offset) + max(station - lane.length, 0.0) + max(0 - station, 0.0))


@kernel_inner
def _distance_with_heading(lane: Lane, station: float, offset: float, heading: float) -> float:
    return _distance(lane, station, offset) + abs(wrap_to_pi(heading - lane_heading(lane, station)))


@kernel_inner
def is_farther(lane: Lane, x: float, y: float, limit: float) -> bool:
    """Return whether the distance of a point is certainly greater than a limit [m]. False is not certain."""
    dx, dy = x - lane.x, y - lane.y
    if lane.kind == CIRCULAR:
        return _is_off_circle(lane, dx, dy, limit) or _is_farther_from_arc(lane, dx, dy, limit)
    offset = abs(dx * -lane.sin + dy * lane.cos) - abs(lane.amplitude)
    station = dx * lane.cos + dy * lane.sin
    return bool(offset + max(station - lane.length, 0.0) + max(0 - station, 0.0) > limit + SLACK)


@kernel_inner
def _is_off_circle(lane: Lane, dx: float, dy: float, limit: float) -> bool:
    """Return whether a point is certainly farther than a limit [m] from an arc's circle. It takes no square root.

    The point is at `dx` and `dy` from the center [m].
    """
    square = dx * dx + dy * dy
    outer, inner = lane.radius + limit + SLACK, max(lane.radius - limit - SLACK, 0.0)
    return bool(square > outer * outer or square < inner * inner)


@kernel_inner
def _is_farther_from_arc(lane: Lane, dx: float, dy: float, limit: float) -> bool:
    """Return whether a point is certainly farther than a limit from an arc; the arguments are `_is_off_circle`'s."""
    distance = math.sqrt(dx * dx + dy * dy)
    beyond = _least_distance_beyond_arc(lane, dx, dy, distance)
    return bool(abs(lane.radius - distance) + beyond > limit + SLACK)


@kernel_inner
def _least_distance_beyond_arc(lane: Lane, dx: float, dy: float, distance: float) -> float:
    """Compute a lower bound of the distance beyond an arc's ends, measured along its circle [m].

    The point is at `dx` and `dy` from the center, and at `distance` in a straight line [m]. The angle between two
    directions is at least the difference of their cosines.
    """
    if distance < SLACK:  # at the center, which is in no direction
        return 0.0
    beyond = lane.cos_half_arc - (dx * lane.cos + dy * lane.sin) / distance
    return float(lane.radius * max(beyond, 0.0))


@kernel_inner
def note_places(network: Network, scene: Scene) -> None:
    """Note where each vehicle and obstacle is on its closest lane, so that it is not computed again in this frame."""
    scratch = scene.scratch
    for i in range(scene.episode.n_vehicles + scene.episode.n_obstacles):
        vehicle = scene.vehicles[i]
        lane = network.lanes[vehicle.lane]
        scratch.stations[i], scratch.offsets[i] = lane_coordinates(lane, vehicle.x, vehicle.y)


@kernel_inner
def update_lane(network: Network, scene: Scene, i: int) -> None:
    """Find the closest lane of vehicle i, which has moved, and note where it is on it: `Vehicle.on_state_update`."""
    vehicle, scratch = scene.vehicles[i], scene.scratch
    lane, station, offset = closest_lane(network, vehicle.lane, vehicle.x, vehicle.y, vehicle.heading)
    vehicle.lane, scratch.stations[i], scratch.offsets[i] = lane, station, offset


@kernel_inner
def coordinates_on(network: Network, scene: Scene, i: int, lane: int) -> tuple[float, float]:
    """Return the station and the offset of vehicle or obstacle i on a lane [m], as noted if it is the closest lane."""
    vehicle = scene.vehicles[i]
    if lane == vehicle.lane:
        return scene.scratch.stations[i], scene.scratch.offsets[i]
    return lane_coordinates(network.lanes[lane], vehicle.x, vehicle.y)
