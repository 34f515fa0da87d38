"""S2: the ego turns left at an unsignalized intersection."""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.logical_scenarios import INTERSECTION_LEFT
from behavexplor.envs.vector_env import vector_env


class IntersectionLeftEnv(DrivingEnv):
    """The ego turns left at an unsignalized intersection (S2).

    ![S2](intersection-left.png)

    The intersection is that of S1. The ego's path crosses the path of oncoming vehicles.

    ## Version history

    - v0: first version.
    """

    logical = INTERSECTION_LEFT


IntersectionLeftVectorEnv = vector_env(IntersectionLeftEnv)
