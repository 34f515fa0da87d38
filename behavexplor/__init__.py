"""BehAVExplor: fuzz a driving policy in traffic scenarios on highway-env to find out how it fails.

    run = behavexplor.find_failures(model, "highway-fast-v0", budget=300)

Importing this package only registers environments with gymnasium: `behavexplor/<functional scenario>-v0`; highway-env's
own, which have a compiled vector form, as `behavexplor/highway-v0` and so on; and `behavexplor/drawn-v0`, which plays
recorded scenarios in any of highway-env's environments. The simulator is imported when an environment is made, and the
Python interface when one of its names is used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from behavexplor.api.campaigns import find_failures
    from behavexplor.api.comparing import Comparison, compare
    from behavexplor.api.conducting import Interrupted
    from behavexplor.api.evaluating import board, evaluate
    from behavexplor.api.run import Run, open_run
    from behavexplor.errors import InputError

__all__ = [
    "Comparison",
    "InputError",
    "Interrupted",
    "Run",
    "board",
    "compare",
    "evaluate",
    "find_failures",
    "open_run",
]
__version__ = "0.1.0"

_INTERFACE = {  # module of each name of the Python interface
    "Comparison": "api.comparing",
    "InputError": "errors",
    "Interrupted": "api.conducting",
    "Run": "api.run",
    "board": "api.evaluating",
    "compare": "api.comparing",
    "evaluate": "api.evaluating",
    "find_failures": "api.campaigns",
    "open_run": "api.run",
}

NAMESPACE = "behavexplor"

FUNCTIONAL_SCENARIOS = {  # entry points of their environments by name
    name: f"behavexplor.envs.functional:{name.title().replace('-', '')}Env"
    for name in ("intersection-left", "intersection-straight", "lane-change", "lane-follow")
}

HIGHWAY_ENV = {  # highway-env's own environments that have a compiled vector form: entry point by name and version
    "highway-v0": "highway_env.envs.highway_env:HighwayEnv",
    "highway-fast-v0": "highway_env.envs.highway_env:HighwayEnvFast",
    "merge-v0": "highway_env.envs.merge_env:MergeEnv",
    "merge-v1": "highway_env.envs.merge_env:ConnectedLaneMergeEnv",
    "merge-generic-v0": "highway_env.envs.merge_env:MergeGenericEnv",
    "merge-generic-v1": "highway_env.envs.merge_env:ConnectedLaneMergeGenericEnv",
    "roundabout-v0": "highway_env.envs.roundabout_env:RoundaboutEnv",
    "roundabout-v1": "highway_env.envs.roundabout_env:ConnectedLaneRoundaboutEnv",
    "intersection-v0": "highway_env.envs.intersection_env:IntersectionEnv",
    "intersection-v1": "highway_env.envs.intersection_env:ContinuousIntersectionEnv",
    "intersection-v2": "highway_env.envs.intersection_env:ConnectedLaneIntersectionEnv",
    "exit-v0": "highway_env.envs.exit_env:ExitEnv",
    "exit-v1": "highway_env.envs.exit_env:ConnectedLaneExitEnv",
    "two-way-v0": "highway_env.envs.two_way_env:TwoWayEnv",
    "u-turn-v0": "highway_env.envs.u_turn_env:UTurnEnv",
    "u-turn-v1": "highway_env.envs.u_turn_env:ConnectedLaneUTurnEnv",
}
_MAX_EPISODE_STEPS = {"two-way-v0": 15}  # as highway-env registers it

for _name, _entry_point in FUNCTIONAL_SCENARIOS.items():
    _id = f"{NAMESPACE}/{_name}-v0"
    if _id not in gymnasium.registry:
        _vector_entry_point = _entry_point.removesuffix("Env") + "VectorEnv"
        gymnasium.register(_id, entry_point=_entry_point, vector_entry_point=_vector_entry_point)

if f"{NAMESPACE}/drawn-v0" not in gymnasium.registry:
    gymnasium.register(f"{NAMESPACE}/drawn-v0", entry_point="behavexplor.envs.making:drawn")

for _name, _entry_point in HIGHWAY_ENV.items():
    _id = f"{NAMESPACE}/{_name}"
    if _id not in gymnasium.registry:
        _vector_entry_point = f"behavexplor.envs.highway.highway_vector_env:{_name.replace('-', '_')}"
        gymnasium.register(
            _id,
            entry_point=_entry_point,
            vector_entry_point=_vector_entry_point,
            max_episode_steps=_MAX_EPISODE_STEPS.get(_name),
        )


def __getattr__(name: str) -> Any:
    """Return a name of the Python interface, whose modules are slow to import."""
    if name not in _INTERFACE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_INTERFACE[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_INTERFACE})
