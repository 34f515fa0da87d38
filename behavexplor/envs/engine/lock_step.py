"""The arguments that all vector environments have: seeds, slots to reset, and the autoreset mode."""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from behavexplor.envs.values import shown
from behavexplor.errors import InputError, unknown_name

Bools = NDArray[np.bool_]


def chosen_mode(name: AutoresetMode | str) -> AutoresetMode:
    """Return the autoreset mode of a name.

    Raises:
        InputError: if there is no such mode.
    """
    if isinstance(name, AutoresetMode):
        return name
    modes = {mode.value: mode for mode in AutoresetMode}
    if name not in modes:
        raise unknown_name("autoreset mode", str(name), modes)
    return modes[name]


def chosen_options(options: dict[str, Any] | None, known: Collection[str]) -> dict[str, Any]:
    """Return the options of a reset.

    Raises:
        InputError: if one of them is unknown.
    """
    for key in options or {}:
        if key not in known:
            raise unknown_name("reset option", str(key), known)
    return options or {}


def chosen_slots(mask: object, num_envs: int) -> Bools:
    """Return which sub-environments the reset option `reset_mask` chooses, shape (num_envs,). None chooses all.

    Raises:
        InputError: if the mask has another shape or type, or chooses none.
    """
    if mask is None:
        return np.ones(num_envs, dtype=bool)
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (num_envs,):
        raise InputError(f"reset_mask: expected an array of {num_envs} booleans, got {shown(mask)}")
    if not mask.any():
        raise InputError("reset_mask: at least one sub-environment must be reset")
    return np.ascontiguousarray(mask)


def chosen_seeds(seed: int | Sequence[int | None] | None, num_envs: int) -> list[int | None]:
    """Return the seed of each sub-environment. A single seed s gives sub-environment i the seed s + i.

    Raises:
        InputError: if there is not one seed for each, or one is not a whole number from 0.
    """
    if seed is None:
        return [None] * num_envs
    seeds = [int(seed) + b for b in range(num_envs)] if isinstance(seed, int | np.integer) else seed
    if not isinstance(seeds, Sequence) or len(seeds) != num_envs:
        raise InputError(f"seed: expected one seed, or a list of {num_envs}, got {shown(seed)}")
    if not all(own is None or (isinstance(own, int | np.integer) and own >= 0) for own in seeds):
        raise InputError(f"seed: expected whole numbers from 0, got {shown(seed)}")
    return [None if own is None else int(own) for own in seeds]
