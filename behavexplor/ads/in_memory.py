"""Drivers that are given as Python objects: functions, objects with a `predict` method, and models in training."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from behavexplor.ads.interface import ADS
from behavexplor.ads.learned.driver import LearnedDriver
from behavexplor.ads.loading import IN_MEMORY, as_driver, check_name
from behavexplor.ads.sb3.description import named_env
from behavexplor.errors import InputError, brief

_HARMLESS: Final = ("VecMonitor", "VecCheckNan")  # wrappers of Stable-Baselines3 that change nothing


@dataclass(frozen=True)
class GivenDriver:
    """A driving system as a user of the Python interface gives it."""

    # name of the driver in a run's configuration. Any process can load the driver by it, unless the name begins with
    # `behavexplor.ads.loading.IN_MEMORY`.
    name: str
    driver: ADS | None = None  # the driver itself; None if it is given by name
    env: str | None = None  # environment in which a model in memory was trained; None if unknown
    is_named: bool = False  # whether the user gave the driver by this name, neither as an object nor by a run folder

    def env_or_trained_in(self, env: Any) -> Any:
        """Return `env` if one was chosen, or else the environment in which the driver was trained; None if unknown.

        Raises:
            InputError: if the files beside a policy name an environment of another package.
        """
        if isinstance(env, str):
            return named_env(env, self.name)
        if env is not None:
            return env
        return named_env(None, self.name) if self.is_named else self.env


def given_driver(given: Any) -> GivenDriver:
    """Return a driver that is given as a name, a function of one observation, an object or a model.

    A name is as in `behavexplor.ads.loading.load_ads`, or a path. The function maps one observation to one action. The
    object has a `predict` method, see `behavexplor.ads.interface.ADS`. The policy of a model of Stable-Baselines3 is
    copied as it is now. What this function has returned is returned again.

    Raises:
        InputError: if it is none of these.
    """
    if isinstance(given, GivenDriver):
        return given
    if isinstance(given, str | Path):
        name = os.path.expanduser(str(given))  # noqa: PTH111 - a name, not always a path
        check_name(name)
        return GivenDriver(name, is_named=True)
    if _is_model(given):
        if (learned := _learned(given)) is not None:
            return learned
        from behavexplor.ads.sb3.model_in_memory import policy_of, training_env  # noqa: PLC0415 - imports torch

        policy: Any = policy_of(given)
        return GivenDriver(f"{IN_MEMORY}:{type(given).__name__}", policy, training_env(given)[0])
    driver = as_driver(given)
    if driver is None:
        kind = "a class: give an instance of it" if isinstance(given, type) else "none of these"
        raise InputError(
            f"A driver must be a name, a function of one observation, an object with a predict method or a model of "
            f"Stable-Baselines3, and {brief(given)} is {kind}"
        )
    label = getattr(given, "__name__", type(given).__name__)
    return GivenDriver(_importable_name(given) or f"{IN_MEMORY}:{label}", driver)


def _is_model(given: Any) -> bool:
    """Return whether an object is a model of Stable-Baselines3, which is not imported for it."""
    module = sys.modules.get("stable_baselines3.common.base_class")
    return module is not None and isinstance(given, module.BaseAlgorithm)


def _learned(model: Any) -> GivenDriver | None:
    """Return the driver of a model that trains in `behavexplor.sb3.learning_env`; None for any other model."""
    module = sys.modules.get("behavexplor.ads.learned.learning")
    env = model.get_env()
    wrappers = []
    while module is not None and env is not None and not isinstance(env, module.LearningVecEnv):
        wrappers.append(type(env).__name__)
        env = getattr(env, "venv", None)
    if module is None or env is None:
        return None
    if changing := [name for name in wrappers if name not in _HARMLESS]:
        raise InputError(
            f"The model sees the features of learning_env through {changing[0]}, without which it cannot drive: train "
            f"it without this wrapper"
        )
    from behavexplor.ads.sb3.dense_layers import trained_network  # noqa: PLC0415 - imports torch
    from behavexplor.ads.sb3.model_in_memory import training_env  # noqa: PLC0415

    driver: Any = LearnedDriver(env.roadmap, trained_network(model.policy))
    return GivenDriver(f"{IN_MEMORY}:{type(model).__name__}", driver, training_env(model)[0])


def _importable_name(given: Any) -> str | None:
    """Return the name by which any process can import an object; None if there is none."""
    module, name = getattr(given, "__module__", "__main__"), getattr(given, "__qualname__", "")
    found = getattr(sys.modules.get(module), name, None) if module != "__main__" else None
    return f"{module}:{name}" if found is given else None
