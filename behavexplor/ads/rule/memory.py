"""What the planner remembers of an ego from one decision to the next: the columns of its state, all 0 at first."""

from typing import Final

DECISION: Final = 0  # code of the speed decision, see `behavexplor.ads.rule.decision`
CLEAR: Final = 1  # how long the junction has been free [s]
LAST_ACCELERATION: Final = 2  # commanded [m/s2]
LAST_STEERING: Final = 3  # commanded [rad]
SURVIVED: Final = 4  # how long the plan is free of contact [s]
STARTED: Final = 5  # 1 after the first decision
LANE: Final = 6  # the lane driven in or changed to, 0 is the route's, 1 the next to the right
ORIGIN: Final = 7  # the lane before the latest change
MANEUVER: Final = 8  # code of the lane decision, see `behavexplor.ads.rule.lane_choice`
START: Final = 9  # station where the present lane change began [m]
LENGTH: Final = 10  # of it along the route [m], 0 while the lane is kept
FROM: Final = 11  # offset there [m]
SLOPE: Final = 12  # and slope there
SINCE: Final = 13  # time since the latest lane change ended [s]
STOOD: Final = 14  # how long the ego has been standing [s]
WAITED: Final = 15  # how long it has been standing while it yields [s]
RESTARTED: Final = 16  # how much longer conflicts are not looked at after a hasty restart (R1-3) [s]
HELD: Final = 17  # how long a steering angle has been held (R2-4) [s]
CREEPS: Final = 18  # time left of creeping forward [s]
OVERRUN: Final = 19  # 1 while the ego does not care for room to come back to its route's lane (R3-2, R3-3)
IGNORES: Final = 20  # 1 while the ego goes on changing lanes although it should abort (R1-6)
OVERTAKING: Final = 21  # 1 from the beginning of an overtaking until the ego is back in its route's lane
SHARP: Final = 22  # 1 during a lane change that is too short (R2-2), and for a while behind it
SLOW_TURN: Final = 23  # 1 after the ego turned left slowly (R2-4), until it steers straight
WEAKENED: Final = 24  # how much longer braking is limited after another's sudden change (R1-4) [s]
REACHED: Final = 25  # bits of the weaknesses whose gates are open, see `behavexplor.ads.rule.weaknesses`
TRIGGERED: Final = 26  # bits of those that changed what a module gave
N_MEMORIES: Final = 27
