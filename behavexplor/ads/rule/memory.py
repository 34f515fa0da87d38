"""Memory of the planner for one ego between two decisions."""

from typing import Final, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats

Memory: TypeAlias = np.record  # of `MEMORY`

MEMORY: Final = np.dtype(
    (
        np.record,
        [
            ("decision", np.float64),  # code of the speed decision, see `behavexplor.ads.rule.decision`
            ("clear", np.float64),  # time for which the junction has been free [s]
            ("last_acceleration", np.float64),  # last commanded acceleration [m/s2]
            ("last_steering", np.float64),  # last commanded steering angle [rad]
            ("survived", np.float64),  # time for which the plan is free of contact [s]
            ("started", np.float64),  # 1 after the first decision
            ("lane", np.float64),  # present lane, or target of the change: 0 is the route's, 1 the next to the right
            ("origin", np.float64),  # lane before the latest change
            ("maneuver", np.float64),  # code of the lane decision, see `behavexplor.ads.rule.lane_choice`
            ("change_start", np.float64),  # station where the present lane change began [m]
            ("change_length", np.float64),  # length of the lane change along the route [m], 0 while the lane is kept
            ("change_offset", np.float64),  # offset at the start of the lane change [m]
            ("change_slope", np.float64),  # slope of the offset at the start of the lane change
            ("since", np.float64),  # time since the latest lane change ended [s]
            ("stood", np.float64),  # time for which the ego has been standing [s]
            ("waited", np.float64),  # time for which the ego has been standing while it yields [s]
            ("restarted", np.float64),  # time left of ignoring conflicts after a hasty restart (R1-3) [s]
            ("held", np.float64),  # time for which a steering angle has been held (R2-4) [s]
            ("creeps", np.float64),  # time left of creeping forward [s]
            ("overrun", np.float64),  # 1 while the ego ignores the room for its return to the route's lane (R3-2, R3-3)
            ("ignores", np.float64),  # 1 while the ego goes on changing lanes although it should abort (R1-6)
            ("overtaking", np.float64),  # 1 from the start of overtaking until the ego is back in its route's lane
            ("sharp", np.float64),  # 1 during a lane change that is too short (R2-2), and for some meters after it
            ("slow_turn", np.float64),  # 1 after the ego turned left slowly (R2-4), until it steers straight
            ("weakened", np.float64),  # time left of limited braking after a sudden change of speed (R1-4) [s]
            ("cost", np.float64),  # cost of the last plan of the speed, which the next one probably has, too
            ("waiting_cost", np.float64),  # cost of the last plan of waiting before the junction, expected for the next
            ("reached", np.float64),  # bits of the weaknesses with open gates, see `behavexplor.ads.rule.weaknesses`
            ("triggered", np.float64),  # bits of the weaknesses that changed the output of a module
        ],
    )
)
N_MEMORIES: Final = len(MEMORY.names or ())


def as_records(state: Floats) -> NDArray[np.record]:
    """Return the state of a batch, shape (B, numbers), as records of `MEMORY` in the same storage, shape (B,)."""
    return cast("NDArray[np.record]", state.view(MEMORY)[:, 0])
