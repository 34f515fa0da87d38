"""Fuzzing while a model of Stable-Baselines3 is trained."""

from behavexplor.sb3.fuzz_callback import FuzzCallback

__all__ = ["FuzzCallback"]
