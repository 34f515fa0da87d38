"""Compiled vector environments: many scenarios in lock-step, as structures of arrays with one kernel over all of them.

`vector_env` makes a `DrivingVectorEnv` for any `behavexplor.envs.driving.DrivingEnv`. A subclass of `DrivingVectorEnv`
that names its `env_class` works as well. Unsupported options are refused.
"""

from behavexplor.envs.vector.env import DrivingVectorEnv, vector_env

__all__ = ["DrivingVectorEnv", "vector_env"]
