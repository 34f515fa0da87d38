"""The vehicles in front of a vehicle and behind it: `Road.neighbour_vehicles`.

No vehicle moves while all of them decide. So each lane has one list of the vehicles on it, made when it is first asked
for in a frame.
"""

from typing import Final

from behavexplor.envs.engine.lane_cache import coordinates_on
from behavexplor.envs.engine.lane_geometry import VEHICLE_LENGTH, is_on_lane, may_be_on_lane
from behavexplor.envs.engine.lane_network import STRAIGHT, Lane, Network
from behavexplor.envs.engine.record_types import Records
from behavexplor.envs.engine.state import Scene
from behavexplor.jit import kernel_inner

NO_VEHICLE: Final = -1
UNKNOWN: Final = -1  # `n_on_lane` of a lane that has not been asked for in this frame
MARGIN: Final = 1.0  # a vehicle this far beside a lane still counts as on it [m]


@kernel_inner
def neighbors(network: Network, scene: Scene, i: int, lane: int, station: float) -> tuple[int, int]:
    """Return the nearest vehicles or obstacles in front and behind, `NO_VEHICLE` if there is none.

    Args:
        network: the road network.
        scene: the episode.
        i: the vehicle, which is not its own neighbor.
        lane: the lane on which its neighbors are.
        station: the vehicle's station on this lane [m].
    """
    on_lane = scene.scratch.on_lane[lane]
    if scene.scratch.n_on_lane[lane] == UNKNOWN:
        scene.scratch.n_on_lane[lane] = _find_on_lane(network, scene, lane, on_lane)
    return _nearest(on_lane, scene.scratch.n_on_lane[lane], i, station)


@kernel_inner
def _nearest(on_lane: Records, count: int, i: int, station: float) -> tuple[int, int]:
    front = rear = NO_VEHICLE
    front_station = rear_station = 0.0
    for k in range(count):
        other = on_lane[k]
        if other.vehicle == i:
            continue
        if station <= other.station:
            if front == NO_VEHICLE or other.station <= front_station:
                front, front_station = other.vehicle, other.station
        elif rear == NO_VEHICLE or other.station > rear_station:
            rear, rear_station = other.vehicle, other.station
    return front, rear


@kernel_inner
def _find_on_lane(network: Network, scene: Scene, lane: int, on_lane: Records) -> int:
    """List the vehicles and obstacles on a lane and on those that it is linked to, each once; return their number."""
    found, vehicles = 0, scene.vehicles
    count = scene.episode.n_vehicles + scene.episode.n_obstacles
    first = network.lanes[lane].first_link
    if network.lanes[lane].kind == STRAIGHT and network.lanes[lane].n_links == 1:
        return _find_on_straight_lane(network.lanes[lane], vehicles, count, on_lane)
    for j in range(count):
        for k in range(first, first + network.lanes[lane].n_links):
            link = network.links[k]
            searched = network.lanes[link.lane]
            if link.lane != vehicles[j].lane and not may_be_on_lane(searched, vehicles[j].x, vehicles[j].y, MARGIN):
                continue
            station, offset = coordinates_on(network, scene, j, link.lane)
            if is_on_lane(searched, station, offset, MARGIN):
                on_lane[found].vehicle = j
                on_lane[found].station = station + link.offset
                found += 1
                break
    return found


@kernel_inner
def _find_on_straight_lane(lane: Lane, vehicles: Records, count: int, on_lane: Records) -> int:
    """List the vehicles on a lane without links to others. It is the most frequent case."""
    found = 0
    start_x, start_y, cos, sin = lane.x, lane.y, lane.cos, lane.sin
    reach, end = lane.width / 2 + MARGIN, lane.length + VEHICLE_LENGTH
    for j in range(count):
        dx, dy = vehicles[j].x - start_x, vehicles[j].y - start_y
        station = dx * cos + dy * sin
        if abs(dx * -sin + dy * cos) <= reach and -VEHICLE_LENGTH <= station < end:
            on_lane[found].vehicle = j
            on_lane[found].station = station
            found += 1
    return found
