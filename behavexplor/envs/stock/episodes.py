"""Many episodes in lock-step: their beginnings and decisions, with observations, rewards and ends."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.envs.stock.collision_grid import GridMemory, observe_times
from behavexplor.envs.stock.frame_log import FrameLog, log_frame
from behavexplor.envs.stock.frames import give_command, run_frames
from behavexplor.envs.stock.observing import View, observe
from behavexplor.envs.stock.pcg64 import Words
from behavexplor.envs.stock.reward_terms import is_terminated, put_terms, reward_of
from behavexplor.envs.stock.state import Scene, Scratch, Slots
from behavexplor.envs.stock.stock_world import World
from behavexplor.envs.stock.task import Task
from behavexplor.jit import kernel_in_place

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

DECISION, WARM_UP, FIRST_LOOK, LOGGED_LOOK = range(4)  # stages of `advance`


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
        log: the frames of the decision, or nothing if it has no room for them.
    """

    observations: Singles
    memory: GridMemory
    rewards: Floats
    terms: Floats
    speeds: Floats
    crashed: Bools
    terminated: Bools
    truncated: Bools
    log: FrameLog


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
def advance(
    engine: Engine,
    slots: Slots,
    scratch: Scratch,
    chosen: Bools,
    commands: Floats,
    changes_lane: Bools,
    outcome: Outcome,
    stage: int,
) -> None:
    """Simulate a decision in the chosen slots, observe the result and judge it; or a part of this.

    One kernel does all of this, because each function that is compiled on its own takes seconds more.

    Args:
        engine: the environment.
        slots: the episodes, changed in place.
        scratch: memory that is used within a frame.
        chosen: whether each slot is advanced, shape (B,).
        commands: see `behavexplor.envs.stock.frames.step`, shape (B, 2).
        changes_lane: whether highway-env takes each action for a change of lane, shape (B,).
        outcome: changed in place.
        stage: DECISION; WARM_UP simulates the traffic before an episode begins; FIRST_LOOK observes and judges only;
            LOGGED_LOOK also logs the start as the first frame.
    """
    world, task = engine.world, engine.task
    for b in range(len(chosen)):
        if not chosen[b]:
            continue
        scene = Scene(slots.episodes[b], slots.vehicles[b], slots.traits[b], slots.routes[b], scratch)
        n_frames = n_logged = 0
        if stage == DECISION:
            give_command(world, scene, commands[b, 0], commands[b, 1])
            n_frames = n_logged = world.rules[0].n_frames
        elif stage == WARM_UP:
            n_frames = task.rules[0].n_warm_up
        frames = outcome.log.frames[b, :n_logged]
        run_frames(world.network, world.rules[0], scene, n_frames, frames, outcome.log.things[b])  # compiled once
        if stage == WARM_UP:
            continue
        episode = scene.episode
        ego = scene.vehicles[episode.ego]
        if stage != DECISION:
            episode.n_side_lanes = world.network.roads[world.network.lanes[ego.lane].road].n_lanes
        if stage == LOGGED_LOOK:
            log_frame(world.network, scene, outcome.log.frames[b, 0], outcome.log.things[b, 0])
        if engine.observed.options[0].is_grid:
            period = world.rules[0].policy_period
            observe_times(world.network, scene, world.speeds, period, outcome.memory, outcome.observations[b])
        else:
            observe(world.network, engine.observed, scene, engine.words[b], outcome.observations[b])
        put_terms(world, task, scene, changes_lane[b], outcome.terms[b])
        outcome.speeds[b], outcome.crashed[b] = ego.speed, ego.crashed
        outcome.rewards[b] = reward_of(task, outcome.terms[b])
        outcome.terminated[b] = stage == DECISION and is_terminated(world, task, scene)
        outcome.truncated[b] = stage == DECISION and episode.time >= task.rules[0].duration
