"""A log of the frames of a decision: where every vehicle and obstacle was after each of them."""

from typing import Final, NamedTuple, TypeAlias

import numpy as np

from behavexplor.envs.engine.lane_geometry import is_on_road
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.state import NO_LANE, Records, Scene, record_type
from behavexplor.jit import kernel_inner

Frame: TypeAlias = np.record

FRAME: Final = record_type(
    n_things=np.int64,  # number of logged vehicles and obstacles; 0 if the slot took no action
    ego=np.int64,  # the ego's place among them
    is_on_road=np.bool_,  # highway-env's `on_road` of the ego
)

THING: Final = record_type(
    number=np.int64,  # of the vehicle or obstacle in its episode, in the order in which they appeared
    x=np.float64,  # [m]
    y=np.float64,
    heading=np.float64,  # [rad]
    speed=np.float64,  # [m/s]
    lane=np.int64,  # number of the closest one, in the order of `RoadNetwork.lanes_dict`; NO_LANE for an obstacle
    target_lane=np.int64,  # the lane that it steers for; NO_LANE if it steers for none
    crashed=np.bool_,
)


class FrameLog(NamedTuple):
    """The frames of the latest decision of B episodes, each with room for N vehicles and obstacles.

    If N is 1, only the ego is logged.
    """

    # the frames themselves, shape (B, frames) of `FRAME`
    frames: Records
    # vehicles in highway-env's order, then obstacles, shape (B, frames, N) of `THING`. What lies beyond `n_things` is
    # undefined.
    things: Records


def make_log(n_slots: int, n_frames: int, n_places: int) -> FrameLog:
    """Create an empty log. If `n_frames` is 0, nothing is ever logged; if `n_places` is 1, only the egos are."""
    return FrameLog(np.zeros((n_slots, n_frames), FRAME), np.zeros((n_slots, n_frames, n_places), THING))


@kernel_inner
def log_frame(network: Network, scene: Scene, frame: Frame, things: Records) -> None:
    """Write the present state of an episode to `frame` and `things`, shape (N,), both changed in place.

    If `things` has one row only, the ego is all that is written.
    """
    episode = scene.episode
    # `scene.vehicles[first : first + count]` is what is written
    first, count = 0, episode.n_vehicles + episode.n_obstacles
    if len(things) == 1:
        first, count = episode.ego, 1
    frame.n_things, frame.ego = count, episode.ego - first  # the ego's place among what is written
    frame.is_on_road = is_on_road(network, scene.vehicles[episode.ego])
    for k in range(count):
        i = first + k
        thing, vehicle = things[k], scene.vehicles[i]
        thing.number, thing.crashed = vehicle.number, vehicle.crashed
        thing.x, thing.y, thing.heading, thing.speed = vehicle.x, vehicle.y, vehicle.heading, vehicle.speed
        thing.lane = thing.target_lane = NO_LANE
        if i < episode.n_vehicles:  # obstacles come after them
            thing.lane, thing.target_lane = vehicle.lane, vehicle.target_lane
