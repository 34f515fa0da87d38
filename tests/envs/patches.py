"""What the engines stand for, patched as programs patch classes, and what compiled environments make of it.

As a script, this module is a process that patches and drives, since a fault of the engine would end it.
"""

import importlib
import json
import subprocess
import sys
import warnings
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import NamedTuple

import gymnasium
import highway_env  # noqa: F401 - registers the environments
import numpy as np
from gymnasium.envs.registration import load_env_creator
from gymnasium.vector import SyncVectorEnv
from highway_env.vehicle.behavior import AggressiveVehicle, DefensiveVehicle

from behavexplor.envs.engine.vehicle_parameters import classes_of_vehicles
from behavexplor.envs.source_gate import MODULES, classes_of
from behavexplor.errors import InputError

MOMENTS = ("before make", "before reset", "before step")
LINEAR = {"other_vehicles_type": "highway_env.vehicle.behavior.AggressiveVehicle"}
WORLDS = {  # environments that consist of all classes between them, with a configuration
    "highway-fast-v0": {"duration": 4, "vehicles_count": 5},
    "highway-v0": {"duration": 4, "vehicles_count": 5, "action": {"type": "ContinuousAction"}, **LINEAR},
    "merge-v1": {"action": {"type": "DiscreteAction"}},
    "roundabout-v1": {"duration": 4},
    "intersection-v2": {"duration": 4},
    "exit-v1": {"duration": 4, "vehicles_count": 5},
    "two-way-v0": {},
    "u-turn-v1": {"duration": 4},
    "intersection-straight-v0": {},
    "lane-change-v0": {"action": {"type": "DiscreteMetaAction"}, "observation": {"type": "Scene"}},
}
N_STEPS = 3


class Patch(NamedTuple):
    """A name of a class or module, in the environment with which it is tried."""

    world: str
    module: str
    owner: str  # "": the module itself
    name: str

    def found(self):
        owner = importlib.import_module(self.module)
        for part in filter(None, self.owner.split(".")):
            owner = getattr(owner, part)
        return owner


@cache
def classes_of_world(world):
    spec = gymnasium.spec(f"behavexplor/{world}")
    env = load_env_creator(spec.entry_point)(config=WORLDS[world])
    known = not str(spec.entry_point).startswith("behavexplor")
    return classes_of(env, classes_of_vehicles(env) if known else map(type, env.road.vehicles))


def classes_of_engines():
    """All classes that the engines stand for."""
    found = {cls: None for world in WORLDS for cls in classes_of_world(world)}
    return [*found, AggressiveVehicle, DefensiveVehicle, load_env_creator("highway_env.envs:IntersectionEnv")]


def patches():
    """Every name on the list, once."""
    found = {}
    for world in WORLDS:
        for owner in (*classes_of_world(world), *MODULES):
            module = owner.__module__ if isinstance(owner, type) else owner.__name__
            name = owner.__qualname__ if isinstance(owner, type) else ""
            for member, value in vars(owner).items():
                is_method = isinstance(value, FunctionType | classmethod | staticmethod | property)
                is_own = isinstance(owner, type) or (is_method and value.__module__ == module)
                if is_own and (is_method or not member.startswith("_")):
                    found.setdefault((module, name, member), Patch(world, module, name, member))
    return list(found.values())


def other(value):
    """Something else in place of a function or a constant, which gives other results but of the same kind."""
    if isinstance(value, property):
        return property(value.fget and other(value.fget), value.fset, value.fdel)
    if isinstance(value, classmethod | staticmethod):
        return type(value)(other(value.__func__))
    if not isinstance(value, FunctionType):
        return "other" if value is None else perturbed(value)

    def patched(*arguments, **options):
        result = value(*arguments, **options)
        road = getattr(arguments[0], "road", None) if arguments else None
        if value.__name__ in ("_create_vehicles", "_make_vehicles", "_reset") and getattr(road, "vehicles", None):
            road.vehicles = road.vehicles[:3]  # as notebooks do
        return perturbed(result)

    return patched


def perturbed(value):
    if isinstance(value, bool | np.bool_):
        return not value
    if isinstance(value, int | float | np.number):
        return value * 1.25 + 1
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return value * 1.25 + 1
    if isinstance(value, list | tuple) and all(isinstance(part, float | int) for part in value):
        return type(value)(part * 1.25 for part in value)
    if isinstance(value, dict):
        return dict(zip(value, [*value.values()][::-1], strict=True))
    return value[::-1] if isinstance(value, list) else value


@contextmanager
def applied(chosen):
    """Patch names, and take it back."""
    with_old = [(patch.found(), patch.name, vars(patch.found())[patch.name]) for patch in chosen]
    for owner, name, value in with_old:
        setattr(owner, name, other(value))
    try:
        yield
    finally:
        for owner, name, value in with_old:
            setattr(owner, name, value)


def try_patches(chosen, moment):
    """What a compiled environment makes of patches at a moment: "refused", "original", "equal" or "different".

    An environment that even the original cannot be made of counts as equal.
    """
    world = chosen[0].world
    made = {}
    if moment != "before make":
        made = {mode: make(world, mode) for mode in ("vector_entry_point", "sync")}
    if moment == "before step":
        for env in made.values():
            env.reset(seed=1)
    with applied(chosen):
        made = made or {"vector_entry_point": attempt(make, world, "vector_entry_point")}
        ours = made["vector_entry_point"]
        if isinstance(ours, InputError):
            return "refused"
        if isinstance(ours, SyncVectorEnv):
            return "original"
        if moment == "before step" and not isinstance(ours, Exception):
            attempt(drive, ours, reset=False)
        seen = ours if isinstance(ours, Exception) else attempt(drive, ours)
        if isinstance(seen, InputError):
            return "refused"
        theirs = made.get("sync") or attempt(make, world, "sync")
        expected = theirs if isinstance(theirs, Exception) else attempt(drive, theirs)
    if isinstance(seen, Exception) or isinstance(expected, Exception):
        return "equal" if type(seen) is type(expected) else "different"
    return "equal" if all(np.allclose(a, b, atol=1e-6) for a, b in zip(seen, expected, strict=True)) else "different"


def make(world, mode):
    return gymnasium.make_vec(f"behavexplor/{world}", num_envs=2, vectorization_mode=mode, config=WORLDS[world])


def attempt(function, *arguments, **options):
    try:
        return function(*arguments, **options)
    except Exception as error:
        return error


def drive(env, *, reset=True):
    seen = [env.reset(seed=3)[0]] if reset else []
    env.action_space.seed(4)
    for _ in range(N_STEPS):
        observations, rewards, terminated, truncated, _ = env.step(env.action_space.sample())
        seen += [observations, rewards, terminated, truncated]
    return seen


def in_child(tries):
    """What becomes of patches at moments, in another process."""
    done = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-m", "tests.envs.patches"],
        input=json.dumps(tries),
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    with suppress(BrokenPipeError):
        outcomes = []
        for chosen, moment in json.load(sys.stdin):
            sys.stderr.write(f"{chosen} {moment}\n")
            outcomes.append(try_patches([Patch(*one) for one in chosen], moment))
        sys.stdout.write(json.dumps(outcomes))
