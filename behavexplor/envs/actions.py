"""Validate actions against an action space."""

from typing import Any

import numpy as np
from gymnasium import Space, spaces

from behavexplor.envs.values import shown
from behavexplor.errors import InputError


def check_actions(space: Space[Any], actions: Any) -> None:
    """Check that an action, or a batch of actions, has the shape of its space and can be carried out.

    Args:
        space: a Discrete, MultiDiscrete or Box space. Any finite number is accepted for a Box, even beyond its bounds.
        actions: the action, or the batch of actions.

    Raises:
        InputError: if the actions do not fit the space; the message says what was expected.
    """
    values = np.asarray(actions)
    fits = values.shape == space.shape
    if isinstance(space, spaces.Box):
        fits = fits and values.dtype.kind in "iuf" and bool(np.isfinite(values).all())
    elif isinstance(space, spaces.MultiDiscrete):  # `contains` takes as long as the decision of a vector environment
        fits = fits and values.dtype.kind in "iu"
        fits = fits and bool(((values >= space.start) & (values < space.start + space.nvec)).all())
    else:
        fits = fits and values.dtype.kind in "iu" and space.contains(values.astype(space.dtype))
    if not fits:
        raise InputError(f"actions: expected finite numbers of {space}, got {shown(actions)}")
