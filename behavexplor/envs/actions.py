"""Whether what somebody wants done is an action at all."""

from typing import Any

import numpy as np
from gymnasium import Space, spaces

from behavexplor.envs.values import shown
from behavexplor.errors import InputError


def check_actions(space: Space[Any], actions: Any) -> None:
    """Whether an action, or a batch of them, has the shape of its space and can be carried out.

    Args:
        space: a Discrete or MultiDiscrete space, or a Box; beyond its bounds every finite number will do.
        actions: the action.

    Raises:
        InputError: saying what was expected.
    """
    values = np.asarray(actions)
    fits = values.shape == space.shape
    if isinstance(space, spaces.Box):
        fits = fits and values.dtype.kind in "iuf" and bool(np.isfinite(values).all())
    else:
        fits = fits and values.dtype.kind in "iu" and space.contains(values.astype(space.dtype))
    if not fits:
        raise InputError(f"actions: expected finite numbers of {space}, got {shown(actions)}")
