"""The state of all episodes in lock-step: one row (slot) for each episode, one record for each vehicle.

A record is structured numpy data whose fields are attributes, in kernels as in Python.
"""

from typing import Final, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats, Ints

Vehicle: TypeAlias = np.record
Traits: TypeAlias = np.record
Episode: TypeAlias = np.record

Records = NDArray[np.record]
RecordType: TypeAlias = np.dtype[np.record]


def record_type(**fields: type) -> RecordType:
    """Create the type of a record from the types of its fields, in their order in memory."""
    return cast("RecordType", np.dtype((np.record, np.dtype(list(fields.items()), align=True))))


PLAIN, MDP, IDM, LINEAR, OBSTACLE = range(5)  # `kind` of a vehicle: highway-env's class
NO_LANE: Final = -1
SAME_NUMBER: Final = -1  # `number` of a step of a route: the lane is not fixed
NO_ROAD: Final = -1  # after the end of a route
NO_ROUTE: Final = -1  # `route_length` of a vehicle whose route is None instead of an empty list

VEHICLE: Final = record_type(
    x=np.float64,  # [m]
    y=np.float64,
    heading=np.float64,  # [rad]
    cos=np.float64,  # of the heading
    sin=np.float64,
    speed=np.float64,  # [m/s]
    steering=np.float64,  # command [rad]
    acceleration=np.float64,  # command [m/s2]
    target_speed=np.float64,  # [m/s]; 0 for PLAIN
    timer=np.float64,  # since the latest decision about a lane change [s]
    impact_x=np.float64,  # of a collision, added to the position in the next frame [m]
    impact_y=np.float64,
    lane=np.int64,  # closest lane
    target_lane=np.int64,  # NO_LANE for PLAIN and OBSTACLE
    speed_index=np.int64,  # of the target speed of MDP
    route_position=np.int64,  # completed steps of the route
    route_length=np.int64,
    number=np.int64,  # of the vehicle or obstacle in its episode, in the order in which they appeared
    has_impact=np.bool_,
    crashed=np.bool_,
    is_yielding=np.bool_,  # by the rules of a RegulatedRoad
)

TRAITS: Final = record_type(
    kind=np.int64,
    length=np.float64,  # [m]
    width=np.float64,  # [m]
    diameter=np.float64,  # distance of opposite corners [m]
    min_speed=np.float64,  # [m/s]
    max_speed=np.float64,  # [m/s]
    max_acceleration=np.float64,  # [m/s2]; the fields from here on are those of IDM and LINEAR
    comfort_acceleration=np.float64,  # [m/s2]
    comfort_braking=np.float64,  # negative [m/s2]
    distance_wanted=np.float64,  # [m]
    time_wanted=np.float64,  # [s]
    gap_divisor=np.float64,  # 2 sqrt(-comfort acceleration x comfort braking) [m/s2]
    delta=np.float64,  # exponent of the speed
    low_delta=np.float64,  # least value of the range from which it is drawn: DELTA_RANGE
    high_delta=np.float64,  # greatest one
    politeness=np.float64,
    min_gain=np.float64,  # LANE_CHANGE_MIN_ACC_GAIN [m/s2]
    max_braking=np.float64,  # LANE_CHANGE_MAX_BRAKING_IMPOSED [m/s2]
    lane_change_delay=np.float64,  # [s]
    speed_gain=np.float64,  # ACCELERATION_PARAMETERS of LINEAR
    front_speed_gain=np.float64,
    front_gap_gain=np.float64,
    heading_gain=np.float64,  # STEERING_PARAMETERS of LINEAR
    offset_gain=np.float64,
    speed_exponent=np.float64,  # 2; the compiler would replace a constant by a product, which rounds differently
    checks_collisions=np.bool_,  # of every kind, as the first six fields are
    changes_lanes=np.bool_,
)

EPISODE: Final = record_type(
    n_vehicles=np.int64,
    n_obstacles=np.int64,
    n_numbered=np.int64,  # vehicles and obstacles that have appeared, including those that have left
    ego=np.int64,  # the ego's place among the vehicles
    frames=np.int64,  # since the reset: `AbstractEnv.steps`
    road_frames=np.int64,  # since the road was made: `RegulatedRoad.steps`
    time=np.float64,  # since the reset [s]
    n_decisions=np.int64,  # since the start
    n_side_lanes=np.int64,  # of the ego's road when it was first observed
)

ROUTE_STEP: Final = record_type(road=np.int64, number=np.int64)  # a road, and the lane on it or SAME_NUMBER

ON_LANE: Final = record_type(vehicle=np.int64, station=np.float64)  # a vehicle's place and its station [m]


class Slots(NamedTuple):
    """B episodes in lock-step, each with room for N vehicles and obstacles.

    A row holds the vehicles first, in highway-env's order, then the obstacles. The rest of it is undefined.
    """

    episodes: Records  # shape (B,) of `EPISODE`
    vehicles: Records  # what changes from frame to frame, shape (B, N) of `VEHICLE`
    traits: Records  # what does not change in an episode, shape (B, N) of `TRAITS`
    routes: Records  # the vehicles' routes, shape (B, N, steps) of `ROUTE_STEP`


class Scratch(NamedTuple):
    """Memory that kernels use within a frame."""

    n_on_lane: Ints  # number of vehicles on each lane, -1 if it has not been asked for in this frame; shape (lanes,)
    on_lane: Records  # these vehicles and their stations [m], shape (lanes, N) of `ON_LANE`
    predictions: Floats  # the vehicles' predicted positions [m] and headings [rad], shape (N, times, 3)
    stations: Floats  # station of each vehicle and obstacle on its closest lane [m], shape (N,)
    offsets: Floats  # offset from it [m], shape (N,)
    copy: Records  # a vehicle whose motion is predicted, shape (1,) of `VEHICLE`
    xs: Floats  # positions along x [m], shape (N,)


class Scene(NamedTuple):
    """One episode: a row of `Slots` and the memory that kernels use.

    Kernels make it in their loop over the slots. Numba cannot return a tuple that contains a record.
    """

    episode: Episode
    vehicles: Records
    traits: Records
    routes: Records
    scratch: Scratch


N_PREDICTIONS: Final = 11  # times at which `RegulatedRoad` predicts positions


def make_slots(n_slots: int, n_places: int, n_steps: int) -> Slots:
    """Create slots without vehicles, each with room for `n_places` vehicles and obstacles and `n_steps` of a route."""
    return Slots(
        episodes=np.zeros(n_slots, EPISODE),
        vehicles=np.zeros((n_slots, n_places), VEHICLE),
        traits=np.zeros((n_slots, n_places), TRAITS),
        routes=np.zeros((n_slots, n_places, n_steps), ROUTE_STEP),
    )


def make_scratch(n_lanes: int, n_places: int) -> Scratch:
    """Create the memory that kernels use within a frame."""
    return Scratch(
        n_on_lane=np.zeros(n_lanes, dtype=np.int64),
        on_lane=np.zeros((n_lanes, n_places), ON_LANE),
        predictions=np.zeros((n_places, N_PREDICTIONS, 3)),
        stations=np.zeros(n_places),
        offsets=np.zeros(n_places),
        copy=np.zeros(1, VEHICLE),
        xs=np.zeros(n_places),
    )
