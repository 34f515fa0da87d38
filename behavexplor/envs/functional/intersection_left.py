"""S2: the ego turns left at an unsignalized intersection."""

from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.roads import crossing
from behavexplor.envs.vector import vector_env


class IntersectionLeftEnv(DrivingEnv):
    """The ego turns left at an unsignalized intersection (S2).

    ![S2](intersection-left.png)

    The intersection is that of S1. The ego's path crosses the path of oncoming vehicles.

    ## Version history

    - v0: first version.
    """

    logical = ScriptedLogicalScenario(
        name="intersection-left",
        roadmap=crossing("left", ego_start=10.0, destination=60.0),
        n_npcs=5,
        waypoints_per_lane=2,
    )


IntersectionLeftVectorEnv = vector_env(IntersectionLeftEnv)
