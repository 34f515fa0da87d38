"""The engine beside highway-env: copied starts, the same actions, and what differs after each decision.

In a process of its own (`compare_in_child`) numpy computes as the C library does, and nothing may differ at all. As a
script, this module is that process.
"""

import json
import logging
import os
import subprocess
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path

import gymnasium
import highway_env  # noqa: F401 - registers the environments
import numpy as np
from gymnasium.envs.registration import load_env_creator

from behavexplor.envs.engine.actions import make_commands
from behavexplor.envs.engine.frame_log import make_log
from behavexplor.envs.engine.frames import give_command, run_frames
from behavexplor.envs.engine.state import EPISODE, VEHICLE, Scene, make_scratch, make_slots
from behavexplor.envs.engine.world import make_world
from behavexplor.envs.highway.conversion import load_state
from behavexplor.envs.highway.highway_vector_env import HighwayVectorEnv
from behavexplor.envs.tasks.highway_tasks import goal_lanes
from behavexplor.envs.tasks.intersection import clear_vehicles
from behavexplor.jit import kernel_in_place
from tests.envs.highway.scattered import scatter

C_LIBRARY = {"NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR", "OPENBLAS_CORETYPE": "Haswell"}
IDS = (
    *("highway-v0", "highway-fast-v0", "merge-v0", "merge-v1", "roundabout-v0", "roundabout-v1", "intersection-v0"),
    *("intersection-v2", "exit-v0", "exit-v1", "two-way-v0", "u-turn-v0", "u-turn-v1"),
    *("merge-generic-v0", "merge-generic-v1", "roundabout-generic-v0", "roundabout-generic-v1"),
)
N_PLACES, N_STEPS = 80, 40
CONTINUOUS = [name for name in VEHICLE.names if VEHICLE[name].kind == "f" and not name.startswith("impact")]
UNIQUE = ("number", "n_numbered")  # which highway-env does not have
DISCRETE = [name for name in VEHICLE.names if VEHICLE[name].kind != "f" and not name.startswith("route")]
DISCRETE = [name for name in DISCRETE if name not in UNIQUE]


@dataclass
class Comparison:
    """What differs between the engine and highway-env in some episodes."""

    episodes: int = 0
    decisions: int = 0
    crashes: int = 0
    worst: dict[str, float] = field(default_factory=lambda: dict.fromkeys([*CONTINUOUS, "impact"], 0.0))
    different: list[str] = field(default_factory=list)  # lanes, targets, flags, routes, numbers of vehicles


def many(env_id, episodes):
    """Fewer episodes in highway-v0, one of which takes highway-env as long as ten of highway-fast-v0."""
    return episodes // 10 if env_id == "highway-v0" else episodes


def make(env_id, config=None):
    return load_env_creator(gymnasium.spec(env_id).entry_point)(config=config)


def world_of(env):
    return make_world(env, goal_lanes(env))


@kernel_in_place
def step(world, slots, scratch, commands, active, log):
    """Simulate one decision of the active slots; commands of shape (B, 2), a log with or without room for frames."""
    for b in range(len(active)):
        if active[b]:
            scene = Scene(slots.episodes[b], slots.vehicles[b], slots.traits[b], slots.routes[b], scratch)
            give_command(world, scene, commands[b, 0], commands[b, 1])
            run_frames(world.network, world.rules[0], scene, world.rules[0].n_frames, log.frames[b], log.things[b])


def compare(env_id, config=None, *, episodes, first_seed=0, decisions=60, scattered=False):
    """Drive highway-env and the engine with random actions from the same starts, to the end of every episode.

    Episodes begin as highway-env begins them, or with vehicles scattered anywhere, whose observation is compared, too.
    """
    env = make(env_id, config)
    world, slots = world_of(env), make_slots(2, N_PLACES, N_STEPS)
    scratch = make_scratch(len(world.network.lanes), N_PLACES)
    compiled = HighwayVectorEnv(type(env), 1, config) if scattered else None
    result = Comparison()
    for seed in range(first_seed, first_seed + episodes):
        env.reset(seed=seed)
        env.action_space.seed(seed)
        if scattered:
            scatter_and_observe(env, compiled, seed, result)
        load_state(env, world, slots, 0)
        fill_rest(slots, scratch)
        drive(env, world, slots, scratch, result, decisions)
        result.episodes += 1
        result.crashes += int(env.vehicle.crashed)
    return result


def scatter_and_observe(env, compiled, seed, result):
    """Put the vehicles of highway-env anywhere, and compare its observation with that of a compiled episode."""
    scatter(env, np.random.default_rng(seed), compiled._slots.routes.shape[2])
    shown, _ = compiled.reset(options={"starts": {0: env}})
    if not np.array_equal(shown[0], env.observation_type.observe(), equal_nan=True):
        result.different.append("observation")


def fill_rest(slots, scratch):
    """Fill the rest of the first slot, which is undefined, with vehicles where others are, beginning with the last."""
    n = int(slots.episodes[0].n_vehicles + slots.episodes[0].n_obstacles)
    same = n - 1 - np.arange(N_PLACES - n) % n
    slots.vehicles[0, n:], slots.traits[0, n:] = slots.vehicles[0, same], slots.traits[0, same]
    scratch.xs[n:] = slots.vehicles[0, n:]["x"]


def drive(env, world, slots, scratch, result, decisions):
    commands = make_commands(env.action_type)
    clears = hasattr(env, "_clear_vehicles")
    for _ in range(decisions):
        action = env.action_space.sample()
        try:
            with np.errstate(invalid="ignore"):  # the reward of TwoWayEnv in the only oncoming lane
                *_, terminated, truncated, _ = env.step(action)
        except ZeroDivisionError:  # the same reward, if it is computed without numpy
            terminated = True
        both = np.repeat(commands(np.array([action])), 2, axis=0)
        step(world, slots, scratch, both, np.array([True, False]), make_log(2, 0, 0))
        if clears:
            clear_first(world, slots, scratch)
        load_state(env, world, slots, 1)
        if clears:
            copy_spawned(slots)
        note_differences(slots, result)
        result.decisions += 1
        if terminated or truncated or result.different:
            break


@kernel_in_place
def clear_first(world, slots, scratch):
    scene = Scene(slots.episodes[0], slots.vehicles[0], slots.traits[0], slots.routes[0], scratch)
    clear_vehicles(world.network, scene)


def copy_spawned(slots):
    """Copy a vehicle that highway-env has just spawned at random."""
    n = slots.episodes[0].n_vehicles
    if slots.episodes[1].n_vehicles == n + 1:
        for rows in (slots.vehicles, slots.traits, slots.routes):
            rows[0, n] = rows[1, n]
        slots.episodes[0].n_vehicles += 1


def note_differences(slots, result):
    ours, theirs = slots.episodes
    compared = [name for name in EPISODE.names if name not in ("n_side_lanes", *UNIQUE)]
    result.different += [name for name in compared if ours[name] != theirs[name]]
    if result.different:
        return
    n = ours.n_vehicles + ours.n_obstacles
    ours, theirs = slots.vehicles[:, :n]
    for name in CONTINUOUS:
        result.worst[name] = max(result.worst[name], float(np.abs(ours[name] - theirs[name]).max()))
    hit = ours["has_impact"] & theirs["has_impact"]
    for name in ("impact_x", "impact_y"):
        deviation = np.abs(ours[name] - theirs[name])[hit].max(initial=0.0)
        result.worst["impact"] = max(result.worst["impact"], float(deviation))
    result.different += [name for name in DISCRETE if (ours[name] != theirs[name]).any()]
    result.different += ["route" for i in range(n) if rest_of_route(slots, 0, i) != rest_of_route(slots, 1, i)]


def rest_of_route(slots, b, i):
    vehicle = slots.vehicles[b, i]
    return slots.routes[b, i, vehicle.route_position : max(vehicle.route_length, 0)].tolist()


def compare_in_child(*calls):
    """Compare in a process in which numpy computes as the C library does; arguments of `compare` by name."""
    return [Comparison(**result) for result in results_of_child("tests.envs.highway.comparison", calls)]


def results_of_child(module, calls):
    """What a module writes as a script, in a process in which numpy computes as the C library does.

    Args:
        module: the module, which calls its `compare`.
        calls: for each comparison, the arguments of `compare` by name.
    """
    done = subprocess.run(
        [sys.executable, "-m", module, json.dumps(calls)],
        env=os.environ | C_LIBRARY,
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    logging.disable(logging.WARNING)  # highway-env's, about routes
    sys.stdout.write(json.dumps([asdict(compare(**call)) for call in json.loads(sys.argv[1])]))
