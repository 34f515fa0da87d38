"""Fuzzing while a model of Stable-Baselines3 is trained, and the environment in which this package trains its own."""

from behavexplor.sb3.fuzz_callback import FuzzCallback
from behavexplor.training import learning_env

__all__ = ["FuzzCallback", "learning_env"]
