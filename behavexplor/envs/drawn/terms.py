"""What highway-env's environments themselves count as a failure, beside a crash.

| environment | R2: off the road | R3: not arrived |
|---|---|---|
| highway, merge, exit, racetrack | `on_road` is false | exit: `is_success` is false at the end |
| intersection | | `has_arrived` is false |
| roundabout | | the ego never entered the circle |
| parking | | `is_success` is false at the end |
| two-way, u-turn, lane-keeping | | |

Where nothing is said, it means nothing: in junctions, a vehicle that drives well leaves its lane for some frames, and
on a two-way road it may overtake. A subclass counts as its parent does.
"""

from collections.abc import Mapping
from typing import Any, Final

from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.exit_env import ExitEnv
from highway_env.envs.highway_env import HighwayEnv
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.merge_env import MergeEnv, MergeGenericEnv
from highway_env.envs.racetrack_env import RacetrackEnv
from highway_env.envs.roundabout_env import RoundaboutEnv

_WITH_BORDERS: Final = (HighwayEnv, MergeEnv, MergeGenericEnv, ExitEnv, RacetrackEnv)


def leaving_matters(env: AbstractEnv) -> bool:
    """Return whether it is a violation that the ego leaves the road."""
    return isinstance(env, _WITH_BORDERS)


def must_move_on(env: AbstractEnv) -> bool:
    """Return whether an ego must drive beyond the first two roads of its route, where no arrival is named."""
    return isinstance(env, RoundaboutEnv)


def has_arrived(env: AbstractEnv, info: Mapping[str, Any]) -> bool | None:
    """Return whether the ego has arrived, as highway-env says; None if the environment has no destination.

    The terms of a subclass's reward do not tell it, since they may be others.
    """
    if "is_success" in info:
        return bool(info["is_success"])
    return bool(env.has_arrived(env.vehicle)) if isinstance(env, IntersectionEnv) else None
