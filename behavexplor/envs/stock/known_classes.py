"""Which environments the compiled engine replaces: highway-env's own, and subclasses with other roads and starts."""

from highway_env.envs.common.abstract import AbstractEnv

from behavexplor.envs.source_gate import REWARDS, replaced
from behavexplor.envs.tasks.highway_tasks import NUMBERS
from behavexplor.errors import InputError

STARTS = frozenset({"_reset", "_make_road", "_create_road", "_make_vehicles", "_create_vehicles"})
_CHANGEABLE = STARTS | {"__init__"}


def known_class(env_class: type[AbstractEnv], *, rewards: bool = True) -> type[AbstractEnv]:
    """Return the class of highway-env whose rules an environment follows: itself, or one of its parents.

    Args:
        env_class: the environment.
        rewards: whether its rewards must be those of that class, too.

    Raises:
        InputError: if there is none, or the environment changes the rules. The message names the changed method.
    """
    known: type[AbstractEnv] | None = next((known for known in NUMBERS if issubclass(env_class, known)), None)
    if known is None:
        names = ", ".join(sorted(one.__name__ for one in NUMBERS))
        raise InputError(
            f"The compiled engine does not know {env_class.__name__}; it knows {names} and subclasses with other roads "
            f"and starts; use gymnasium.make_vec with vectorization_mode='sync'"
        )
    method = replaced(env_class, known, _CHANGEABLE if rewards else _CHANGEABLE | REWARDS)
    if method is not None:
        raise InputError(
            f"The compiled engine does not know the method {method}; use gymnasium.make_vec with "
            f"vectorization_mode='sync'"
        )
    return known


def has_own_starts(env_class: type[AbstractEnv]) -> bool:
    """Return whether an environment changes the road or the first vehicles of the class whose rules it follows."""
    known = known_class(env_class, rewards=False)
    return any(getattr(env_class, name, None) is not getattr(known, name, None) for name in STARTS)
