"""S1: the ego goes straight through an unsignalized intersection."""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.logical_scenarios import INTERSECTION_STRAIGHT
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
