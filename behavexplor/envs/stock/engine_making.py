"""Make the tables and arrays of the compiled engine from an environment of highway-env."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.observation import TimeToCollisionObservation
from highway_env.utils import class_from_path

from behavexplor.envs.engine.collision_grid import make_memory
from behavexplor.envs.engine.frame_log import FrameLog
from behavexplor.envs.engine.observing import grid_view, make_view
from behavexplor.envs.engine.pcg64 import N_WORDS
from behavexplor.envs.engine.state import make_slots
from behavexplor.envs.engine.world import OTHER, make_world
from behavexplor.envs.source_gate import OF_INTERSECTION
from behavexplor.envs.stock.conversion import load
from behavexplor.envs.stock.episodes import N_FLAGS, N_NUMBERS, Engine, Outcome
from behavexplor.envs.tasks.highway_tasks import KINDS, goal_lanes
from behavexplor.envs.tasks.task import Task, make_starts, make_task, no_starts

_ROOM = 16  # more vehicles than in the first episode, for environments that place their own


def make_engine(
    env: AbstractEnv, number: int, num_envs: int, *, places_own: bool, most_decisions: int | None
) -> Engine:
    """Return what the episodes of an environment have in common.

    Args:
        env: the environment, which has been reset.
        number: number of its kind in `KINDS`.
        num_envs: number of episodes in lock-step.
        places_own: whether it makes its own road or vehicles.
        most_decisions: number of decisions after which an episode is truncated, if there is one.
    """
    kind, world = KINDS[number], make_world(env, goal_lanes(env))
    if isinstance(env, kind.unaware):
        world.templates[OTHER].checks_collisions = False
    n_vehicles = len(env.road.vehicles)
    example = make_slots(1, n_vehicles + len(env.road.objects), len(world.network.roads) + 1)
    load(env, world, example, 0)
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
    n_new = int(task.rules[0].n_new)
    return n_new and n_new * math.ceil(float(env.config["duration"] * env.config["policy_frequency"])) + 2


def make_outcome(env: AbstractEnv, engine: Engine, num_envs: int, log: FrameLog) -> Outcome:
    """Create the arrays of observations, rewards and ends, with the log of the frames."""
    shape = env.observation_space.shape
    return Outcome(
        observations=np.zeros((num_envs, math.prod(shape[:-1]), shape[-1]), dtype=np.float32),
        memory=make_memory(engine.world.network, len(engine.world.speeds), shape[-1]),
        numbers=np.zeros((N_NUMBERS, num_envs)),
        flags=np.zeros((N_FLAGS, num_envs), dtype=bool),
        log=log,
    )


@contextmanager
def kept_class(env_class: type[AbstractEnv], config: Mapping[str, Any] | None) -> Iterator[None]:
    """Undo what `IntersectionEnv` does to the class of its vehicles, which would change every other environment."""
    traffic = class_from_path({**env_class.default_config(), **(config or {})}["other_vehicles_type"])
    before = {name: vars(traffic)[name] for name in OF_INTERSECTION if name in vars(traffic)}
    try:
        yield
    finally:
        for name in OF_INTERSECTION:
            if name in before:
                setattr(traffic, name, before[name])
            elif name in vars(traffic):
                delattr(traffic, name)
