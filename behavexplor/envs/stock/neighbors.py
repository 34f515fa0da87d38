"""The vehicles in front of a vehicle and behind it: `Road.neighbour_vehicles`.

No vehicle moves while all of them decide. So each lane has one list of the vehicles on it, made when it is first asked
for in a frame.
"""

from typing import Final

from behavexplor.envs.stock.lane_network import Network
from behavexplor.envs.stock.lanes import is_on_lane, lane_coordinates
from behavexplor.envs.stock.state import Scene
from behavexplor.jit import kernel_in_place

NOBODY: Final = -1
MARGIN: Final = 1.0  # a vehicle this far beside a lane still counts as on it [m]


@kernel_in_place
def forget_neighbors(scene: Scene) -> None:
    """Begin a frame: forget which vehicles are on which lane."""
    for lane in range(len(scene.scratch.n_on_lane)):
        scene.scratch.n_on_lane[lane] = NOBODY


@kernel_in_place
def neighbors(network: Network, scene: Scene, i: int, lane: int, station: float) -> tuple[int, int]:
    """Return the nearest vehicles or obstacles in front and behind, `NOBODY` if there is none.

    Args:
        network: the road network.
        scene: the episode.
        i: the vehicle, which is not its own neighbor.
        lane: the lane on which its neighbors are.
        station: the vehicle's station on this lane [m].
    """
    if scene.scratch.n_on_lane[lane] < 0:
        _find_on_lane(network, scene, lane)
    front = rear = NOBODY
    front_station = rear_station = 0.0
    for k in range(scene.scratch.n_on_lane[lane]):
        other = scene.scratch.on_lane[lane, k]
        if other.vehicle == i:
            continue
        if station <= other.station:
            if front == NOBODY or other.station <= front_station:
                front, front_station = other.vehicle, other.station
        elif rear == NOBODY or other.station > rear_station:
            rear, rear_station = other.vehicle, other.station
    return front, rear


@kernel_in_place
def _find_on_lane(network: Network, scene: Scene, lane: int) -> None:
    """List the vehicles and obstacles on a lane and on those that it is linked to, each once."""
    count = 0
    first = network.lanes[lane].first_link
    for j in range(scene.episode.n_vehicles + scene.episode.n_obstacles):
        other = scene.vehicles[j]
        for k in range(first, first + network.lanes[lane].n_links):
            link = network.links[k]
            searched = network.lanes[link.lane]
            station, offset = lane_coordinates(searched, other.x, other.y)
            if is_on_lane(searched, station, offset, MARGIN):
                scene.scratch.on_lane[lane, count].vehicle = j
                scene.scratch.on_lane[lane, count].station = station + link.offset
                count += 1
                break
    scene.scratch.n_on_lane[lane] = count
