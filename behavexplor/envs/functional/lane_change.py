"""S4: the ego changes two lanes to the right on a straight road with four lanes."""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.logical_scenarios import LANE_CHANGE
from behavexplor.envs.vector_env import vector_env


class LaneChangeEnv(DrivingEnv):
    """The ego changes two lanes to the right on a straight road with four lanes (S4).

    ![S4](lane-change.png)

    The road is that of S3. The ego starts in the second lane from the left.

    ## Version history

    - v0: first version.
    """

    logical = LANE_CHANGE


LaneChangeVectorEnv = vector_env(LaneChangeEnv)
