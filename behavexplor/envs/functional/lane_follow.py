"""S3: the ego follows its lane on a straight road with four lanes."""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.logical_scenarios import LANE_FOLLOW
from behavexplor.envs.vector_env import vector_env


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
