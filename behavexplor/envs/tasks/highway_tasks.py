"""All kinds of highway-env's tasks, with the starts that are compiled for each of them."""

from collections.abc import Callable
from types import MappingProxyType
from typing import Final

from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import LaneIndex

from behavexplor.envs.engine.pcg64 import Words
from behavexplor.envs.engine.state import Scene
from behavexplor.envs.engine.world import BARRIER, World
from behavexplor.envs.tasks import exit as exit_road
from behavexplor.envs.tasks import highway, intersection, merge, roundabout, two_way, u_turn
from behavexplor.envs.tasks.task import Task, TaskKind
from behavexplor.jit import kernel_inner

# An environment is of the first kind with its class or a parent of it: a subclass comes before its parents.
KINDS: Final[tuple[TaskKind, ...]] = (
    exit_road.KIND,
    highway.KIND,
    merge.GENERIC_KIND,
    merge.KIND,
    roundabout.KIND,
    u_turn.KIND,
    two_way.KIND,
    intersection.KIND,
)
_EXIT, _HIGHWAY, _MERGE_GENERIC, _MERGE, _ROUNDABOUT, _U_TURN, _TWO_WAY, _INTERSECTION = range(8)  # their numbers
NUMBERS: Final = MappingProxyType({cls: number for number, kind in enumerate(KINDS) for cls in kind.env_classes})
MOST_TERMS: Final = max(len(kind.terms) for kind in KINDS)


def goal_lanes(env: AbstractEnv) -> Callable[[LaneIndex], bool]:
    """Return the function that says which lanes of an environment are goals."""
    number = next((number for cls, number in NUMBERS.items() if isinstance(env, cls)), None)
    return lambda index: number is not None and KINDS[number].is_goal(index, env.config)


@kernel_inner
def start(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place an episode's first vehicles and obstacles, drawing from the generator `words`: `AbstractEnv._reset`."""
    episode, kind = scene.episode, task.rules[0].kind
    episode.n_vehicles = episode.n_obstacles = episode.n_numbered = 0
    episode.ego = episode.frames = episode.road_frames = 0
    episode.time = 0.0
    if kind == _EXIT:
        exit_road.start(world, task, scene, words)
    elif kind == _HIGHWAY:
        highway.start(world, task, scene, words)
    elif kind == _MERGE_GENERIC:
        merge.start_generic(world, task, scene, words)
    elif kind == _MERGE:
        merge.start(world, task, scene, words)
    elif kind == _ROUNDABOUT:
        roundabout.start(world, task, scene, words)
    elif kind == _U_TURN:
        u_turn.start(world, task, scene, words)
    elif kind == _TWO_WAY:
        two_way.start(world, task, scene, words)
    elif kind == _INTERSECTION:
        intersection.start(world, task, scene, words)
    for k in range(len(task.starts.obstacles)):
        scene.vehicles[episode.n_vehicles + k] = task.starts.obstacles[k]
        scene.traits[episode.n_vehicles + k] = world.templates[BARRIER]
        scene.vehicles[episode.n_vehicles + k].number = episode.n_numbered
        episode.n_numbered += 1
    episode.n_obstacles = len(task.starts.obstacles)


@kernel_inner
def enter(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Place the vehicles that appear after the frames of `n_warm_up`."""
    if task.rules[0].kind == _INTERSECTION:
        intersection.enter(world, task, scene, words)


@kernel_inner
def renew_traffic(world: World, task: Task, scene: Scene, words: Words) -> None:
    """Let vehicles leave and appear after a decision."""
    if task.rules[0].kind == _INTERSECTION:
        intersection.renew_traffic(world, task, scene, words)
