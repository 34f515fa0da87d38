"""The functional scenarios S1 to S4 as gymnasium environments, each with its vector environment.

To add a scenario, add its logical scenario to `behavexplor.envs.logical_scenarios.LOGICAL_SCENARIOS`, two classes that
are named after it here, and its name to `behavexplor.FUNCTIONAL_SCENARIOS`: `lane-follow` has `LaneFollowEnv` and
`LaneFollowVectorEnv`, and is registered as `behavexplor/lane-follow-v0`. Because campaigns find the logical scenario
there, they need not import the simulator, which would take them a second.
"""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.logical_scenarios import INTERSECTION_LEFT, INTERSECTION_STRAIGHT, LANE_CHANGE, LANE_FOLLOW
from behavexplor.envs.vector_env import vector_env


class IntersectionStraightEnv(DrivingEnv):
    """The ego goes straight through an unsignalized intersection (S1).

    ![S1](intersection-straight.png)

    Two roads with two lanes in each direction cross. The ego comes from the south on the inner lane. No vehicle has the
    right of way.

    ## Version history

    - v0: first version.
    """

    logical = INTERSECTION_STRAIGHT


IntersectionStraightVectorEnv = vector_env(IntersectionStraightEnv)


class IntersectionLeftEnv(DrivingEnv):
    """The ego turns left at an unsignalized intersection (S2).

    ![S2](intersection-left.png)

    The intersection is that of S1. The ego's path crosses the path of oncoming vehicles.

    ## Version history

    - v0: first version.
    """

    logical = INTERSECTION_LEFT


IntersectionLeftVectorEnv = vector_env(IntersectionLeftEnv)


class LaneFollowEnv(DrivingEnv):
    """The ego follows its lane on a straight road with four lanes (S3).

    ![S3](lane-follow.png)

    Four lanes run in the ego's direction, and the ego starts in the third from the left. The lanes of the opposite
    direction lie beyond the double yellow line.

    ## Version history

    - v0: first version.
    """

    logical = LANE_FOLLOW


LaneFollowVectorEnv = vector_env(LaneFollowEnv)


class LaneChangeEnv(DrivingEnv):
    """The ego changes two lanes to the right on a straight road with four lanes (S4).

    ![S4](lane-change.png)

    The road is that of S3. The ego starts in the second lane from the left.

    ## Version history

    - v0: first version.
    """

    logical = LANE_CHANGE


LaneChangeVectorEnv = vector_env(LaneChangeEnv)
