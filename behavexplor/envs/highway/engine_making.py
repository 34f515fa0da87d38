"""Make the tables and arrays of the compiled engine from an environment of highway-env, and fill them from outside.

Options of `HighwayVectorEnv.reset` fill some of the slots that are reset:

- `starts`: {slot: environment of highway-env, unwrapped, that has just been reset}. Its state is copied, and its random
  generator, if that is numpy's. If the order of the observation is "shuffled", the first one has an order of its own.
- `draws`: {slot: array of shape (n,)}. The draws that the episode makes from then on, in their order and in standard
  form; see `behavexplor.envs.engine.pcg64`. At an intersection, each vehicle that may appear takes `N_DRAWS` of
  `behavexplor.envs.tasks.intersection`, even if it does not appear. The generator draws again after the last of them.
  The first observation of a start must not draw.
"""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.observation import TimeToCollisionObservation

from behavexplor.data.array_types import Bools, Floats
from behavexplor.envs.engine.frame_log import FrameLog
from behavexplor.envs.engine.lane_network import make_network
from behavexplor.envs.engine.observing import grid_view, make_memory, make_view
from behavexplor.envs.engine.pcg64 import N_WORDS, generator_words, give
from behavexplor.envs.engine.state import Slots, make_slots
from behavexplor.envs.engine.world import OTHER, make_world
from behavexplor.envs.highway.config_check import DRAWING
from behavexplor.envs.highway.conversion import load_state
from behavexplor.envs.highway.episodes import N_FLAGS, N_NUMBERS, Engine, StepResults
from behavexplor.envs.tasks.highway_tasks import KINDS, goal_lanes
from behavexplor.envs.tasks.task import Task, make_starts, make_task, no_starts
from behavexplor.envs.values import shown
from behavexplor.errors import InputError

_ROOM = 16  # more vehicles than in the first episode, for environments that place their own
_NO_DRAWS: Final = np.zeros(0)
_NO_NUMBERS: Final = np.full(1, np.nan)  # what stands for draws that are no array of numbers
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


def make_engine(
    env: AbstractEnv, number: int, num_envs: int, *, places_own: bool, most_decisions: int | None
) -> Engine:
    """Return what the episodes of an environment that has been reset have in common.

    `number` is that of its kind, and `places_own` says whether it makes its own road or vehicles. After
    `most_decisions`, an episode is truncated; None for no limit.
    """
    kind, world = KINDS[number], make_world(env, goal_lanes(env))
    if isinstance(env, kind.unaware):
        world.templates[OTHER].checks_collisions = False
    n_vehicles = len(env.road.vehicles)
    example = make_slots(1, n_vehicles + len(env.road.objects), len(world.network.roads) + 1)
    load_state(env, world, example, 0)
    makes_starts = not places_own or kind.has_newcomers
    starts = make_starts(env, kind, example.vehicles[0, n_vehicles:].copy()) if makes_starts else no_starts()
    is_grid = isinstance(env.observation_type, TimeToCollisionObservation)
    return Engine(
        world=world,
        task=make_task(env, number, kind, starts, most_decisions),
        observed=grid_view() if is_grid else make_view(env.observation_type),
        words=np.zeros((num_envs, N_WORDS), dtype=np.uint64),
    )


def most_at_start(env: AbstractEnv, task: Task, *, places_own: bool) -> int:
    """Return the greatest number of vehicles and obstacles that an episode can begin with."""
    if places_own:
        return 2 * (len(env.road.vehicles) + len(env.road.objects)) + _ROOM
    return int(task.rules[0].n_at_start) + len(task.starts.obstacles)


def most_new(env: AbstractEnv, task: Task) -> int:
    """Return the greatest number of vehicles that can appear in an episode after its start."""
    n_new = int(task.rules[0].n_new)  # after each decision
    if n_new == 0:
        return 0
    return n_new * math.ceil(float(env.config["duration"] * env.config["policy_frequency"])) + 2


def make_results(env: AbstractEnv, engine: Engine, num_envs: int, log: FrameLog) -> StepResults:
    """Create the arrays of observations, rewards and ends, with the log of the frames."""
    shape = env.observation_space.shape
    return StepResults(
        observations=np.zeros((num_envs, math.prod(shape[:-1]), shape[-1]), dtype=np.float32),
        memory=make_memory(engine.world.network, len(engine.world.speeds), shape[-1]),
        numbers=np.zeros((N_NUMBERS, num_envs)),
        flags=np.zeros((N_FLAGS, num_envs), dtype=bool),
        log=log,
    )


def copy_start(env: AbstractEnv, engine: Engine, slots: Slots, b: int, most: int) -> None:
    """Copy the start of an episode to slot b, with the generator if it is numpy's `Generator` on `PCG64`.

    Raises:
        InputError: if the environment has another road, more than `most` vehicles and obstacles, or some that the
            engine does not know.
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
    load_state(env, engine.world, slots, b)
    generator: object = env.np_random
    if type(generator) is np.random.Generator and isinstance(generator.bit_generator, np.random.PCG64):
        engine.words[b, :N_WORDS] = generator_words(generator)


def chosen_starts(
    starts: object, env_class: type[AbstractEnv], config: Mapping[str, Any], mask: Bools
) -> dict[int, AbstractEnv]:
    """Return the environments of the reset option `starts`, by their slot; none if it is None.

    Each must be of `env_class` and have the configuration, but for what only matters to drawing and starts.

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
    """Return the reset option `draws`: for each slot an array of shape (n,); none if it is None.

    Raises:
        InputError: if a slot is not reset, or the draws are not finite numbers.
    """
    given = _by_slot("draws", draws, mask)
    forms = {b: _floats(one) for b, one in given.items()}
    if forms and not np.isfinite(np.concatenate(list(forms.values()))).all():  # all at once, which is faster
        wrong = next(given[b] for b, one in forms.items() if not np.isfinite(one).all())
        raise InputError(f"draws: expected finite numbers of shape (n,), got {shown(wrong)}")
    return forms


def with_draws(engine: Engine, mask: Bools, draws: Mapping[int, Floats]) -> Engine:
    """Give draws to some of the slots that are reset, and take those away that the others had.

    The engine that is returned has more room for draws if that is needed.
    """
    words = engine.words
    if not draws and words.shape[1] == N_WORDS:  # no slot has had any
        return engine
    lacking = N_WORDS + max(map(len, draws.values()), default=0) - words.shape[1]
    if lacking > 0:
        words = np.pad(words, ((0, 0), (0, lacking)))
    for b in np.flatnonzero(mask).tolist():
        give(words[b], draws.get(b, _NO_DRAWS))
    return engine._replace(words=words)


def _by_slot(name: str, given: object, mask: Bools) -> dict[int, Any]:
    found = {} if given is None else given
    if not isinstance(found, Mapping):
        raise InputError(f"{name}: expected a value for each slot, such as {{0: ...}}, got {shown(given)}")
    for b in found:
        if not isinstance(b, int | np.integer) or not 0 <= b < len(mask) or not mask[b]:
            raise InputError(f"{name}: {shown(b)} is not a slot that is reset")
    return {int(b): value for b, value in found.items()}


def _floats(draws: object) -> Floats:
    """Return draws as an array of shape (n,), or one NaN if they cannot be one."""
    try:
        forms = np.asarray(draws, dtype=np.float64)
    except (TypeError, ValueError):
        forms = _NO_NUMBERS
    return forms if forms.ndim == 1 else _NO_NUMBERS
