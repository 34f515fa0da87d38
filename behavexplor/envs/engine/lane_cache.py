"""Where vehicles and obstacles are on lanes. What is known of their closest lanes is not computed again in a frame."""

from behavexplor.envs.engine.lane_geometry import closest_lane, lane_coordinates
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.state import Scene
from behavexplor.jit import kernel_inner


@kernel_inner
def note_places(network: Network, scene: Scene) -> None:
    """Note where each vehicle and obstacle is on its closest lane."""
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
    """Return the station and the offset of vehicle or obstacle i on a lane [m]."""
    vehicle = scene.vehicles[i]
    if lane == vehicle.lane:
        return scene.scratch.stations[i], scene.scratch.offsets[i]
    return lane_coordinates(network.lanes[lane], vehicle.x, vehicle.y)
