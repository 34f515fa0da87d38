"""Starts of episodes that highway-env has made, and draws that are given instead of taken from a generator.

These are options of `StockVectorEnv.reset`, for some of the slots that are reset:

- `starts`: {slot: environment of highway-env, unwrapped, that has just been reset}. Its state is copied, and its random
  generator, if that is numpy's. If the order of the observation is "shuffled", the first one has an order of its own.
- `draws`: {slot: array of shape (n,)}. The draws that the episode makes from then on, in their order and in
  standard form; see `behavexplor.envs.engine.pcg64`. At an intersection, each vehicle that may appear takes `N_DRAWS`,
  also if it does not appear. The generator draws again after the last of them. The first observation of a start must
  not draw.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from numpy.typing import NDArray

from behavexplor.envs.engine.lane_network import make_network
from behavexplor.envs.engine.pcg64 import N_WORDS, generator_words, give
from behavexplor.envs.engine.state import Slots
from behavexplor.envs.stock.config_check import DRAWING
from behavexplor.envs.stock.conversion import load
from behavexplor.envs.stock.episodes import Engine
from behavexplor.envs.tasks.highway_tasks import goal_lanes
from behavexplor.envs.values import shown
from behavexplor.errors import InputError

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

_NONE: Final = np.zeros(0)
_OF_STARTS: Final = frozenset(  # keys of the config that matter to starts only
    {
        "vehicles_count",
        "initial_lane_id",
        "ego_spacing",
        "vehicles_density",
        "incoming_vehicle_destination",
        "destination",
        "initial_vehicle_count",
    }
)


def copy_start(env: AbstractEnv, engine: Engine, slots: Slots, b: int, most: int) -> None:
    """Copy the start of an episode to slot b, with the generator if it is numpy's `Generator` on `PCG64`.

    Args:
        env: an environment that has just been reset.
        engine: what the episodes have in common; the slot's generator is changed in place.
        slots: the slots, changed in place.
        b: the slot.
        most: greatest number of vehicles and obstacles that a start may have.

    Raises:
        InputError: if the environment has another road, or vehicles that the engine does not know.
    """
    options = {"connected_lanes": env.config["neighbour_vehicles_connected_lanes"], "is_goal": goal_lanes(env)}
    road = make_network(env.road.network, **options)
    for own, new in zip(engine.world.network, road, strict=True):
        if own.shape != new.shape or (own != new).any():
            raise InputError(f"The road of {type(env).__name__} changes; the compiled engine needs one road")
    count = len(env.road.vehicles) + len(env.road.objects)
    if count > most:
        raise InputError(
            f"A start of {type(env).__name__} has {count} vehicles and obstacles, but there is room for {most}; make "
            "the vector environment with a config for more"
        )
    load(env, engine.world, slots, b)
    generator: object = env.np_random
    if type(generator) is np.random.Generator and isinstance(generator.bit_generator, np.random.PCG64):
        engine.words[b, :N_WORDS] = generator_words(generator)


def chosen_starts(
    starts: object, env_class: type[AbstractEnv], config: Mapping[str, Any], mask: Bools
) -> dict[int, AbstractEnv]:
    """Return the environments of the reset option `starts`, by their slot.

    Args:
        starts: the option, or None.
        env_class: the class that they must have.
        config: the configuration that they must have, besides drawing and what matters to starts only.
        mask: which slots are reset, shape (B,).

    Raises:
        InputError: if a slot is not reset, or an environment is another one.
    """
    found = _by_slot("starts", starts, mask)
    for env in found.values():
        if type(env) is not env_class or getattr(env, "road", None) is None:
            raise InputError(f"starts: expected {env_class.__name__} that have been reset, unwrapped, got {shown(env)}")
        for key in config.keys() - DRAWING - _OF_STARTS:
            if env.config.get(key) != config[key]:
                raise InputError(f"starts: {key} is {shown(env.config.get(key))}, but must be {shown(config[key])}")
    return found


def chosen_draws(draws: object, mask: Bools) -> dict[int, Floats]:
    """Return the reset option `draws`: for each slot an array of shape (n,).

    Args:
        draws: the option, or None.
        mask: which slots are reset, shape (B,).

    Raises:
        InputError: if a slot is not reset, or the draws are not finite numbers.
    """
    return {b: _checked_draws(forms) for b, forms in _by_slot("draws", draws, mask).items()}


def with_draws(engine: Engine, mask: Bools, draws: Mapping[int, Floats]) -> Engine:
    """Give draws to some of the slots that are reset, and take those away that the others had.

    Returns:
        The engine, with more room for draws if that is needed.
    """
    words = engine.words
    if not draws and words.shape[1] == N_WORDS:  # no slot has had any
        return engine
    lacking = N_WORDS + max(map(len, draws.values()), default=0) - words.shape[1]
    if lacking > 0:
        words = np.pad(words, ((0, 0), (0, lacking)))
    for b in np.flatnonzero(mask).tolist():
        give(words[b], draws.get(b, _NONE))
    return engine._replace(words=words)


def _by_slot(name: str, given: object, mask: Bools) -> dict[int, Any]:
    found = {} if given is None else given
    if not isinstance(found, Mapping):
        raise InputError(f"{name}: expected a value for each slot, such as {{0: ...}}, got {shown(given)}")
    for b in found:
        if not isinstance(b, int | np.integer) or not 0 <= b < len(mask) or not mask[b]:
            raise InputError(f"{name}: {shown(b)} is not a slot that is reset")
    return {int(b): value for b, value in found.items()}


def _checked_draws(draws: object) -> Floats:
    try:
        forms = np.array(draws, dtype=np.float64)
    except (TypeError, ValueError):
        forms = np.full(1, np.nan)
    if forms.ndim != 1 or not np.isfinite(forms).all():
        raise InputError(f"draws: expected finite numbers of shape (n,), got {shown(draws)}")
    return forms
