"""The observation `TimeToCollision`: when the ego would meet other vehicles, for its speeds and lanes."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.envs.engine.lane_geometry import lane_coordinates
from behavexplor.envs.engine.lane_keeping import not_zero
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.state import Scene
from behavexplor.jit import kernel_inner

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

N_SHOWN: Final = 3  # speeds, and lanes, of the observation
DEPTH: Final = 3  # roads ahead on which vehicles are considered


class GridMemory(NamedTuple):
    """Memory for the observation.

    Attributes:
        grid: cost of each cell, shape (speeds, lanes, times), with the lanes of the widest road.
        stack: roads that are still to be searched, shape (3 x roads + 1, 3).
    """

    grid: Singles
    stack: Ints


def make_memory(network: Network, n_speeds: int, n_times: int) -> GridMemory:
    """Create the memory for observations of `n_speeds` speeds and `n_times` times."""
    n_lanes = max(road.n_lanes for road in network.roads)
    stack = np.zeros((DEPTH * len(network.roads) + 1, 3), dtype=np.int64)
    return GridMemory(np.zeros((n_speeds, n_lanes, n_times), dtype=np.float32), stack)


@kernel_inner
def observe_times(
    network: Network, scene: Scene, speeds: Floats, period: float, memory: GridMemory, observation: Singles
) -> None:
    """Fill a TimeToCollision observation.

    Args:
        network: the road network.
        scene: the episode.
        speeds: the ego's target speeds, shape (speeds,) [m/s].
        period: duration of a cell of the grid [s].
        memory: overwritten.
        observation: the observation, shape (9, times): three speeds times three lanes.
    """
    ego = scene.vehicles[scene.episode.ego]
    lane = network.lanes[ego.lane]
    n_speeds, n_lanes = len(speeds), network.roads[lane.road].n_lanes
    grid = memory.grid
    _fill_grid(network, scene, speeds, period, memory)
    for a in range(N_SHOWN):
        speed = min(max(ego.speed_index + a - N_SHOWN // 2, 0), n_speeds - 1)
        for b in range(N_SHOWN):
            shown = lane.number + b - N_SHOWN // 2
            is_lane = shown >= 0 and shown < n_lanes
            for time in range(grid.shape[2]):
                observation[a * N_SHOWN + b, time] = grid[speed, shown, time] if is_lane else 1.0


@kernel_inner
def _fill_grid(network: Network, scene: Scene, speeds: Floats, period: float, memory: GridMemory) -> None:
    """Compute the cost of each cell: `compute_ttc_grid`."""
    grid = memory.grid
    grid[:] = 0.0
    ego = scene.vehicles[scene.episode.ego]
    lane = network.lanes[ego.lane]
    n_lanes = network.roads[lane.road].n_lanes
    own, _ = lane_coordinates(lane, ego.x, ego.y)
    for j in range(scene.episode.n_vehicles):
        other = scene.vehicles[j]
        road = network.lanes[other.lane].road
        if j == scene.episode.ego or not _is_connected(network, scene, road, memory.stack):
            continue
        first, last = 0, n_lanes
        if network.roads[road].n_lanes == n_lanes:
            first = network.lanes[other.lane].number
            last = first + 1
        gap = lane_coordinates(lane, other.x, other.y)[0] - own
        projected = other.speed * (other.cos * ego.cos + other.sin * ego.sin)
        margin = scene.traits[j].length / 2 + scene.traits[scene.episode.ego].length / 2
        for k in range(len(speeds)):
            if speeds[k] == other.speed:
                continue
            closing = not_zero(speeds[k] - projected)
            _mark(grid[k], first, last, gap / closing / period, 1.0)
            _mark(grid[k], first, last, (gap - margin) / closing / period, 0.5)
            _mark(grid[k], first, last, (gap + margin) / closing / period, 0.5)


@kernel_inner
def _mark(grid: Singles, first: int, last: int, time: float, cost: float) -> None:
    """Raise the cost of a time, in cells, on the lanes from `first` to before `last`."""
    if time < 0:
        return
    for rounded in (math.floor(time), math.ceil(time)):
        if rounded < grid.shape[1]:
            for lane in range(first, last):
                cell = int(rounded)
                grid[lane, cell] = max(grid[lane, cell], np.float32(cost))


@kernel_inner
def _is_connected(network: Network, scene: Scene, road: int, stack: Ints) -> bool:
    """Return whether vehicles on a road can be met on the ego's way: `RoadNetwork.is_connected_road`."""
    ego, route = scene.vehicles[scene.episode.ego], scene.routes[scene.episode.ego]
    stack[0, 0], stack[0, 1], stack[0, 2] = network.lanes[ego.lane].road, ego.route_position, DEPTH
    count = 1
    while count > 0:
        count -= 1
        reached, position, depth = stack[count, 0], stack[count, 1], stack[count, 2]
        if road == reached or network.roads[road].target == network.roads[reached].origin:
            return True
        if depth == 0:
            continue
        while position < ego.route_length and route[position].road == reached:
            position += 1
        target = network.roads[reached].target
        if position < ego.route_length and network.roads[route[position].road].origin == target:
            stack[count, 0], stack[count, 1], stack[count, 2] = route[position].road, position + 1, depth - 1
            count += 1
            continue
        first = network.roads[reached].first_exit
        for k in range(first, first + network.roads[reached].n_exits):
            stack[count, 0], stack[count, 1], stack[count, 2] = network.exits[k], position, depth - 1
            count += 1
    return False
