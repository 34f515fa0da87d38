"""S4: the ego changes two lanes to the right on a straight road with four lanes."""

from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.roads import straight_road
from behavexplor.envs.vector import vector_env


class LaneChangeEnv(DrivingEnv):
    """The ego changes two lanes to the right on a straight road with four lanes (S4).

    ![S4](lane-change.png)

    The road is that of S3. The ego starts in the second lane from the left.

    ## Version history

    - v0: first version.
    """

    logical = ScriptedLogicalScenario(
        name="lane-change",
        roadmap=straight_road(start_lane=1, target_lane=3, ego_start=10.0, destination=230.0),
        n_npcs=6,
        waypoints_per_lane=4,
    )


LaneChangeVectorEnv = vector_env(LaneChangeEnv)
