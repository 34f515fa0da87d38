"""Starts of episodes that highway-env has made, and draws that are given instead of taken from a generator.

These are options of `StockVectorEnv.reset`, for some of the slots that are reset:

- `starts`: {slot: environment of highway-env, unwrapped, that has just been reset}. Its state is copied, and its random
  generator, if that is numpy's. If the order of the observation is "shuffled", the first one has an order of its own.
- `spawn_draws`, at intersections: {slot: array of shape (decisions, 6)}. A row has the draws after a decision that
  decide which vehicle appears, in standard form: u of the probability, the choice of the origin and another one of the
  destination (0 to 3), z of the station, z of the speed, u of `DELTA`. After the last row, the generator draws again.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from numpy.typing import NDArray

from behavexplor.envs.stock.config_check import DRAWING
from behavexplor.envs.stock.conversion import load
from behavexplor.envs.stock.episodes import Engine
from behavexplor.envs.stock.lane_network import make_network
from behavexplor.envs.stock.pcg64 import generator_words
from behavexplor.envs.stock.state import IDM, Slots
from behavexplor.envs.stock.stock_world import OTHER, goal_lanes
from behavexplor.envs.stock.task import INTERSECTION
from behavexplor.envs.values import shown
from behavexplor.errors import InputError

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

N_DRAWS: Final = 6
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
        engine.words[b] = generator_words(generator)


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


def chosen_draws(draws: object, kind: int, engine: Engine, mask: Bools) -> dict[int, Floats]:
    """Return the reset option `spawn_draws`: for each slot an array of shape (decisions, 6).

    Args:
        draws: the option, or None.
        kind: the environment's kind.
        engine: what the episodes have in common.
        mask: which slots are reset, shape (B,).

    Raises:
        InputError: if the environment lets no vehicles appear, or the draws are not what they should be.
    """
    found = _by_slot("spawn_draws", draws, mask)
    if found and (kind != INTERSECTION or engine.world.templates[OTHER].kind != IDM):
        raise InputError("spawn_draws: only intersections with IDMVehicles let vehicles appear by these draws")
    return {b: _checked_draws(rows) for b, rows in found.items()}


def with_draws(given: Floats, mask: Bools, draws: Mapping[int, Floats]) -> Floats:
    """Return the draws of all slots after a reset, shape (B, decisions + 1, 6), where NaN stands for no draw.

    Args:
        given: the draws before the reset, of the same form.
        mask: which slots are reset, shape (B,).
        draws: the draws of some of them, each of shape (decisions, 6).
    """
    longest = max([len(given[0]) - 1, *map(len, draws.values())])
    table = np.full((len(given), longest + 1, N_DRAWS), np.nan)
    table[~mask, : len(given[0])] = given[~mask]
    for b, rows in draws.items():
        table[b, : len(rows)] = rows
    return table


def _by_slot(name: str, given: object, mask: Bools) -> dict[int, Any]:
    found = {} if given is None else given
    if not isinstance(found, Mapping):
        raise InputError(f"{name}: expected a value for each slot, such as {{0: ...}}, got {shown(given)}")
    for b in found:
        if not isinstance(b, int | np.integer) or not 0 <= b < len(mask) or not mask[b]:
            raise InputError(f"{name}: {shown(b)} is not a slot that is reset")
    return {int(b): value for b, value in found.items()}


def _checked_draws(rows: object) -> Floats:
    try:
        table = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        table = np.zeros(0)
    if table.ndim != 2 or table.shape[1] != N_DRAWS or not np.isfinite(table).all():
        raise InputError(f"spawn_draws: expected finite numbers of shape (decisions, {N_DRAWS}), got {shown(rows)}")
    shares, choices = table[:, [0, 5]], table[:, 1:3]
    if (shares < 0).any() or (shares >= 1).any():
        raise InputError("spawn_draws: the first and last column must be in [0, 1)")
    if not np.isin(choices, range(4)).all() or (choices[:, 0] == choices[:, 1]).any():
        raise InputError("spawn_draws: the second and third column must be two different numbers from 0 to 3")
    return table
