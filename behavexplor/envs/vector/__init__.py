"""The environments in lock-step and compiled: structure of arrays, one kernel over all scenarios.

`DrivingVectorEnv` is made for any `behavexplor.envs.driving.DrivingEnv` by `vector_env`, or by a subclass that
names its `env_class`; what it cannot do it refuses.
"""

from behavexplor.envs.vector.env import DrivingVectorEnv, vector_env

__all__ = ["DrivingVectorEnv", "vector_env"]
