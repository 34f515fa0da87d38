"""Many episodes in lock-step: their beginnings and decisions, with observations, rewards and ends."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.envs.stock.collision_grid import GridMemory, observe_times
from behavexplor.envs.stock.intersections import spawn_vehicle
from behavexplor.envs.stock.observe import View, observe
from behavexplor.envs.stock.pcg64 import Words
from behavexplor.envs.stock.resets import start_episode
from behavexplor.envs.stock.rewards import is_terminated, put_terms, reward_of
from behavexplor.envs.stock.state import Scene, Scratch, Slots
from behavexplor.envs.stock.step import clear_vehicles, simulate
from behavexplor.envs.stock.task import INTERSECTION, Task
from behavexplor.envs.stock.world import World
from behavexplor.jit import kernel_in_place

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


class Outcome(NamedTuple):
    """What B egos observed and received in their latest decision.

    Attributes:
        observations: shape (B, rows, columns): vehicles and features, or speeds times lanes and times.
        memory: for the observation TimeToCollision.
        rewards: shape (B,).
        terms: the terms of the rewards, shape (B, 5).
        speeds: the egos' speeds, shape (B,) [m/s].
        crashed: whether each ego has crashed, shape (B,).
        terminated: whether each episode is terminated, shape (B,).
        truncated: whether each episode is truncated, shape (B,).
    """

    observations: Singles
    memory: GridMemory
    rewards: Floats
    terms: Floats
    speeds: Floats
    crashed: Bools
    terminated: Bools
    truncated: Bools


class Engine(NamedTuple):
    """What an environment's episodes have in common, and their random generators.

    Attributes:
        world: the road and the vehicles' classes.
        task: starts, rewards and ends.
        observed: options of the observation.
        words: the generators, shape (B, 6); see `behavexplor.envs.stock.pcg64`.
    """

    world: World
    task: Task
    observed: View
    words: Words


@kernel_in_place
def begin(
    engine: Engine, slots: Slots, scratch: Scratch, chosen: Bools, changes_lane: Bools, outcome: Outcome
) -> None:
    """Begin episodes in the chosen slots, and observe them.

    Args:
        engine: the environment.
        slots: the episodes, changed in place.
        scratch: memory that is used within a frame.
        chosen: whether an episode begins in each slot, shape (B,).
        changes_lane: whether an action is a change of lane, for the terms of the reward, shape (B,).
        outcome: changed in place.
    """
    for b in range(len(chosen)):
        if chosen[b]:
            scene = Scene(slots.episodes[b], slots.vehicles[b], slots.traits[b], slots.routes[b], scratch)
            start_episode(engine.world, engine.task, scene, engine.words[b])
            _observe_first(engine, scene, b, changes_lane[b], outcome)


@kernel_in_place
def observe_starts(
    engine: Engine, slots: Slots, scratch: Scratch, chosen: Bools, changes_lane: Bools, outcome: Outcome
) -> None:
    """Observe episodes in the chosen slots that have just begun. The arguments are those of `begin`."""
    for b in range(len(chosen)):
        if chosen[b]:
            scene = Scene(slots.episodes[b], slots.vehicles[b], slots.traits[b], slots.routes[b], scratch)
            _observe_first(engine, scene, b, changes_lane[b], outcome)


@kernel_in_place
def advance(
    engine: Engine,
    slots: Slots,
    scratch: Scratch,
    active: Bools,
    commands: Floats,
    changes_lane: Bools,
    outcome: Outcome,
) -> None:
    """Simulate a decision in the active slots, observe the result and judge it.

    Args:
        engine: the environment.
        slots: the episodes, changed in place.
        scratch: memory that is used within a frame.
        active: whether each slot is simulated, shape (B,).
        commands: see `behavexplor.envs.stock.step.step`, shape (B, 2).
        changes_lane: whether highway-env takes each action for a change of lane, shape (B,).
        outcome: changed in place.
    """
    world, task = engine.world, engine.task
    for b in range(len(active)):
        if not active[b]:
            continue
        scene = Scene(slots.episodes[b], slots.vehicles[b], slots.traits[b], slots.routes[b], scratch)
        simulate(world, scene, commands[b, 0], commands[b, 1])
        _observe(engine, scene, b, outcome)
        put_terms(world, task, scene, changes_lane[b], outcome.terms[b])
        _put_ego(scene, b, outcome)
        outcome.rewards[b] = reward_of(task, outcome.terms[b])
        outcome.terminated[b] = is_terminated(world, task, scene)
        outcome.truncated[b] = scene.episode.time >= task.rules[0].duration
        if task.rules[0].kind == INTERSECTION:
            clear_vehicles(world.network, scene)
            spawn_vehicle(world, task, scene, engine.words[b])


@kernel_in_place
def _observe_first(engine: Engine, scene: Scene, b: int, changes_lane: bool, outcome: Outcome) -> None:
    lane = engine.world.network.lanes[scene.vehicles[scene.episode.ego].lane]
    scene.episode.n_side_lanes = engine.world.network.roads[lane.road].n_lanes
    _observe(engine, scene, b, outcome)
    put_terms(engine.world, engine.task, scene, changes_lane, outcome.terms[b])
    _put_ego(scene, b, outcome)
    outcome.rewards[b] = 0.0
    outcome.terminated[b] = outcome.truncated[b] = False


@kernel_in_place
def _observe(engine: Engine, scene: Scene, b: int, outcome: Outcome) -> None:
    world = engine.world
    if engine.observed.options[0].is_grid:
        period = world.rules[0].policy_period
        observe_times(world.network, scene, world.speeds, period, outcome.memory, outcome.observations[b])
    else:
        observe(world.network, engine.observed, scene, engine.words[b], outcome.observations[b])


@kernel_in_place
def _put_ego(scene: Scene, b: int, outcome: Outcome) -> None:
    ego = scene.vehicles[scene.episode.ego]
    outcome.speeds[b], outcome.crashed[b] = ego.speed, ego.crashed
