"""Memory of the planner for one ego between two decisions: the columns of its state, all 0 at first."""

from typing import Final

DECISION: Final = 0  # code of the speed decision, see `behavexplor.ads.rule.decision`
CLEAR: Final = 1  # time for which the junction has been free [s]
LAST_ACCELERATION: Final = 2  # last commanded acceleration [m/s2]
LAST_STEERING: Final = 3  # last commanded steering angle [rad]
SURVIVED: Final = 4  # time for which the plan is free of contact [s]
STARTED: Final = 5  # 1 after the first decision
LANE: Final = 6  # present lane or target of the lane change: 0 is the route's, 1 the next to the right
ORIGIN: Final = 7  # lane before the latest change
MANEUVER: Final = 8  # code of the lane decision, see `behavexplor.ads.rule.lane_choice`
START: Final = 9  # station where the present lane change began [m]
LENGTH: Final = 10  # length of the lane change along the route [m], 0 while the lane is kept
FROM: Final = 11  # offset at the start of the lane change [m]
SLOPE: Final = 12  # slope of the offset at the start of the lane change
SINCE: Final = 13  # time since the latest lane change ended [s]
STOOD: Final = 14  # time for which the ego has been standing [s]
WAITED: Final = 15  # time for which the ego has been standing while it yields [s]
RESTARTED: Final = 16  # time left of ignoring conflicts after a hasty restart (R1-3) [s]
HELD: Final = 17  # time for which a steering angle has been held (R2-4) [s]
CREEPS: Final = 18  # time left of creeping forward [s]
OVERRUN: Final = 19  # 1 while the ego ignores the room needed to return to its route's lane (R3-2, R3-3)
IGNORES: Final = 20  # 1 while the ego goes on changing lanes although it should abort (R1-6)
OVERTAKING: Final = 21  # 1 from the start of overtaking until the ego is back in its route's lane
SHARP: Final = 22  # 1 during a lane change that is too short (R2-2), and for some meters after it
SLOW_TURN: Final = 23  # 1 after the ego turned left slowly (R2-4), until it steers straight
WEAKENED: Final = 24  # time left of limited braking after another vehicle's sudden change of speed (R1-4) [s]
REACHED: Final = 25  # bits of the weaknesses whose gates are open, see `behavexplor.ads.rule.weaknesses`
TRIGGERED: Final = 26  # bits of the weaknesses that changed the output of a module
N_MEMORIES: Final = 27
