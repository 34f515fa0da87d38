"""S1: the ego goes straight through an unsignalized intersection."""

from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.roads import crossing
from behavexplor.envs.vector import vector_env


class IntersectionStraightEnv(DrivingEnv):
    """The ego goes straight through an unsignalized intersection (S1).

    ![S1](intersection-straight.png)

    Two roads with two lanes in each direction cross. The ego comes from the south on the inner lane. No vehicle has the
    right of way.

    ## Version history

    - v0: first version.
    """

    logical = ScriptedLogicalScenario(
        name="intersection-straight",
        roadmap=crossing("straight", ego_start=20.0, destination=60.0),
        n_npcs=5,
        waypoints_per_lane=2,
    )


IntersectionStraightVectorEnv = vector_env(IntersectionStraightEnv)
