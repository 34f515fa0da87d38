"""Many episodes in lock-step: their beginnings and decisions, with observations, rewards, ends and infos."""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Array, Bools, Floats, Ints, Singles
from behavexplor.envs.engine.frame_log import FrameLog, log_frame
from behavexplor.envs.engine.frames import give_command, run_frames
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.observing import GridMemory, View, observe, observe_times
from behavexplor.envs.engine.pcg64 import Words, shuffle_rows
from behavexplor.envs.engine.state import Records, Scene, Scratch, Slots
from behavexplor.envs.engine.world import World
from behavexplor.envs.tasks.highway_tasks import MOST_TERMS, enter, renew_traffic, start
from behavexplor.envs.tasks.reward_terms import is_terminated, put_terms, reward_of
from behavexplor.envs.tasks.task import Task, TaskKind
from behavexplor.jit import kernel_in_place, kernel_inner

DECISION, BEGINNING, LOOK = range(3)  # stages of `advance`
REFUSED, FULL = -1, -2  # what `advance` returns if an action is none of the choices, or an episode has no room

REWARD, SPEED, FIRST_TERM = range(3)  # rows of `StepResults.numbers`
N_NUMBERS: Final = FIRST_TERM + MOST_TERMS
TERMINATED, TRUNCATED, STEPPED, CRASHED, FIRST_FLAG = range(5)  # rows of `StepResults.flags`
N_FLAGS: Final = FIRST_FLAG + MOST_TERMS


class StepResults(NamedTuple):
    """What B egos observed and received in their latest decision.

    Few arrays with many rows are copied faster than many arrays.
    """

    observations: Singles  # shape (B, rows, columns): vehicles and features, or speeds times lanes and times
    memory: GridMemory  # for the observation TimeToCollision
    numbers: Floats  # the rewards, the egos' speeds [m/s] and the terms of the rewards, shape (N_NUMBERS, B)
    # whether each episode is terminated, whether it is truncated, whether the latest call of `advance` took an action
    # in it, whether the ego has crashed, and whether each term is other than 0, shape (N_FLAGS, B)
    flags: Bools
    log: FrameLog  # the frames of the decision, or nothing if it has no room for them


class Engine(NamedTuple):
    """What an environment's episodes have in common, and their random generators."""

    world: World  # the road and the vehicles' classes
    task: Task  # starts, rewards and ends
    observed: View  # options of the observation
    words: Words  # the generators, shape (B, 6); see `behavexplor.envs.engine.pcg64`


class Actions(NamedTuple):
    """The actions of B egos, as a choice of commands."""

    # the commands; see `behavexplor.envs.engine.frames.give_command`, shape (n, 2). They are the same at all times if
    # the actions are discrete. Otherwise, each ego has its own.
    commands: Floats
    choices: Ints  # the number of each ego's command, shape (B,)


@kernel_in_place
def advance(
    engine: Engine,
    slots: Slots,
    scratch: Scratch,
    results: StepResults,
    chosen: Bools,
    actions: Actions,
    stage: int,
    logs_start: bool,
) -> int:
    """Simulate a decision in the chosen slots, or begin episodes in them; then observe the result and judge it.

    One kernel does all of this, because each function that is compiled on its own takes seconds more.

    `chosen` says which slots, shape (B,). The stage DECISION simulates a decision, and episodes that have ended rest;
    BEGINNING begins episodes; LOOK observes and judges those that have been begun elsewhere. With `logs_start`, the
    start is logged as the first frame. The generators, slots, scratch and results are changed in place.

    Return the number of chosen slots whose episode has ended. If a choice is none of the commands, return REFUSED, and
    if a slot has no room for the vehicles, FULL; nothing has changed then.
    """
    refusal = _refusal(engine.task, slots, chosen, actions, stage)
    if refusal < 0:
        return refusal
    world, task, is_decision, n_ended = engine.world, engine.task, stage == DECISION, 0
    for b in range(len(chosen)):
        if not chosen[b]:
            continue
        words, numbers, flags = engine.words[b], results.numbers[:, b], results.flags[:, b]
        frames, things = results.log.frames[b], results.log.things[b]
        if is_decision and (flags[TERMINATED] or flags[TRUNCATED]):
            _rest(numbers, flags, frames)
            n_ended += 1
            continue
        flags[STEPPED] = is_decision
        scene = Scene(slots.episodes[b], slots.vehicles[b], slots.traits[b], slots.routes[b], scratch)
        choice = actions.choices[b]
        n_frames = n_logged = 0
        if is_decision:
            scene.episode.n_decisions += 1
            give_command(world, scene, actions.commands[choice, 0], actions.commands[choice, 1])
            n_frames = n_logged = world.rules[0].n_frames
        elif stage == BEGINNING:
            start(world, task, scene, words)
            n_frames = task.rules[0].n_warm_up
        run_frames(world.network, world.rules[0], scene, n_frames, frames[:n_logged], things)  # compiled once
        if stage == BEGINNING:
            enter(world, task, scene, words)
        if not is_decision:
            _note_start(world.network, scene, frames[:logs_start], things)
        _look(world, engine.observed, scene, words, results.memory, results.observations[b])
        _judge(world, task, scene, choice, numbers, flags)
        if is_decision:
            renew_traffic(world, task, scene, words)
        n_ended += flags[TERMINATED] or flags[TRUNCATED]
    return n_ended


@kernel_inner
def _refusal(task: Task, slots: Slots, chosen: Bools, actions: Actions, stage: int) -> int:
    """Return why nothing can be done; 0 if there is no reason."""
    if not _are_known(actions):
        return REFUSED
    return 0 if _have_room(task, slots, chosen, stage) else FULL


@kernel_inner
def _are_known(actions: Actions) -> bool:
    n_known = 0
    for choice in actions.choices:
        n_known += 0 <= choice < len(actions.commands)
    return n_known == len(actions.choices)


@kernel_inner
def _have_room(task: Task, slots: Slots, chosen: Bools, stage: int) -> bool:
    """Return whether each chosen episode has an ego, and room for what it has, begins with or receives."""
    n_places, rules = slots.vehicles.shape[1], task.rules[0]
    for b in range(len(chosen)):
        episode = slots.episodes[b]
        n_things = episode.n_vehicles + episode.n_obstacles
        if stage == BEGINNING:
            n_things = max(rules.n_at_start, 1 + rules.n_others) + len(task.starts.obstacles)
        elif stage == DECISION:
            n_things += rules.n_new
        is_odd = stage != BEGINNING and (min(episode.ego, episode.n_obstacles) < 0 or episode.ego >= episode.n_vehicles)
        if chosen[b] and (is_odd or n_things > n_places):
            return False
    return True


@kernel_inner
def _rest(numbers: Floats, flags: Bools, frames: Records) -> None:
    numbers[REWARD] = 0.0
    flags[STEPPED] = False
    for k in range(len(frames)):
        frames[k].n_things = 0


@kernel_inner
def _note_start(network: Network, scene: Scene, frames: Records, things: Records) -> None:
    """Note that the episode has just begun, and where. If `frames` has a frame, it shows the start."""
    lane = network.lanes[scene.vehicles[scene.episode.ego].lane]
    scene.episode.n_side_lanes = network.roads[lane.road].n_lanes
    scene.episode.n_decisions = 0
    if len(frames) > 0:
        log_frame(network, scene, frames[0], things[0])


@kernel_inner
def _look(world: World, observed: View, scene: Scene, words: Words, memory: GridMemory, observation: Singles) -> None:
    if observed.options[0].is_grid:
        observe_times(world.network, scene, world.speeds, world.rules[0].policy_period, memory, observation)
    else:
        observe(world.network, observed, scene, observation)
        if observed.options[0].is_shuffled:
            shuffle_rows(words, observation, 1)


@kernel_inner
def _judge(world: World, task: Task, scene: Scene, choice: int, numbers: Floats, flags: Bools) -> None:
    """Compute rewards and ends. An episode that has just begun has not ended."""
    episode, rules, ego = scene.episode, task.rules[0], scene.vehicles[scene.episode.ego]
    changes_lane = choice in (0, 2)  # highway-env looks at the number alone, also if it means another action
    put_terms(world, rules, task.terms, scene, changes_lane, numbers[FIRST_TERM:])
    numbers[REWARD], numbers[SPEED] = reward_of(world, rules, task.terms, scene, numbers[FIRST_TERM:]), ego.speed
    for k in range(MOST_TERMS):
        flags[FIRST_FLAG + k] = numbers[FIRST_TERM + k] != 0.0
    is_late = episode.time >= rules.duration or episode.n_decisions >= rules.most_decisions
    flags[CRASHED] = ego.crashed
    flags[TERMINATED] = flags[STEPPED] and is_terminated(world, rules, scene)
    flags[TRUNCATED] = flags[STEPPED] and is_late


def infos_of(kind: TaskKind, numbers: Floats, flags: Bools, actions: Array, chosen: Bools) -> dict[str, Any]:
    """Return the infos of highway-env's single environments as gymnasium's vector environments collect them.

    The infos consist of parts of the numbers and flags, in which what is not chosen becomes 0, and of the actions. So
    numbers and flags must be copies. `chosen` says which sub-environments have an info, shape (B,).
    """
    others = None if all(chosen.tolist()) else ~chosen  # what is not chosen, if there is any
    if others is not None:
        np.copyto(numbers[SPEED:], 0.0, where=others)
        np.copyto(flags[CRASHED:], False, where=others)
        actions = actions.copy()
        actions[others] = 0
    rewards: dict[str, Any] = {}
    for k, (name, mask_name, wanted) in enumerate(kind.named_terms):
        if wanted is float:
            rewards[name] = numbers[FIRST_TERM + k]
        elif wanted is int:
            rewards[name] = numbers[FIRST_TERM + k].astype(int)
        elif wanted is bool:
            rewards[name] = flags[FIRST_FLAG + k]
        else:
            rewards[name] = _without(flags[FIRST_FLAG + k].astype(object), others)
        rewards[mask_name] = chosen
    infos: dict[str, Any] = {
        "speed": numbers[SPEED],
        "_speed": chosen,
        "crashed": flags[CRASHED],
        "_crashed": chosen,
        "action": actions,
        "_action": chosen,
        "rewards": rewards,
        "_rewards": chosen,
    }
    if kind.has_agents:
        ended = flags[CRASHED] | flags[FIRST_FLAG + kind.position(kind.arrival)]
        infos |= {"agents_rewards": _tuples(numbers[REWARD], others), "_agents_rewards": chosen}
        infos |= {"agents_terminated": _tuples(ended, others), "_agents_terminated": chosen}
    stepped = flags[STEPPED] & chosen
    if kind.success is not None and np.count_nonzero(stepped):  # highway-env has it after a decision, not after a reset
        is_success = flags[FIRST_FLAG + kind.position(kind.success)]
        infos |= {"is_success": is_success & stepped, "_is_success": stepped}
    return infos


def _tuples(values: Array, others: Bools | None) -> NDArray[np.object_]:
    """Return each value as a tuple of one, as highway-env's multi-agent environments have it."""
    return _without(np.fromiter(zip(values.tolist(), strict=True), dtype=object), others)


def _without(objects: NDArray[np.object_], others: Bools | None) -> NDArray[np.object_]:
    if others is not None:
        objects[others] = None
    return objects
