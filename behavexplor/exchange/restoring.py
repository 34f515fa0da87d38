"""Scenarios from scenes: the reverse of an export."""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.drawn_logical import DrawnLogicalScenario
from behavexplor.data.logical import LogicalScenario
from behavexplor.data.scenario import Scenario
from behavexplor.data.scripted import NPC, ScriptedScenario
from behavexplor.data.scripted_logical import ScriptedLogicalScenario, scripted
from behavexplor.errors import InputError, unknown_name
from behavexplor.exchange.fitting import fitted_script
from behavexplor.exchange.scenes import Mover, Scene

_SAME: Final = 0.01  # greatest deviation of a place or size that counts as the same [m]


def restored(scene: Scene, logical: LogicalScenario) -> Scenario:
    """Return the scenario of a scene.

    The script of a vehicle counts. If its motion was changed by hand, or it has no script, one is fitted to its motion.

    Args:
        scene: the scene, as it was read.
        logical: the scenarios of the scene's environment.

    Raises:
        InputError: if the scene cannot be taken; the message names what is wrong.
    """
    if isinstance(logical, DrawnLogicalScenario):
        return _drawn(scene, logical)
    ranges = scripted(logical, "A scene")
    _check_ego(scene.movers[0], ranges)
    scenario = ScriptedScenario(ranges.name, tuple(_npc(mover, ranges) for mover in scene.movers[1:]))
    try:
        ranges.check(scenario)
    except InputError as error:
        raise InputError(f"This scene is not one of {ranges.name}: {_named(str(error), scene)}") from None
    return scenario


def _named(message: str, scene: Scene) -> str:
    """Return a message with the names of the scene's vehicles in place of their numbers."""
    for i in reversed(range(len(scene.movers) - 1)):
        message = message.replace(f"npcs[{i}].", f"{scene.movers[i + 1].name}: ")
    return message


def _drawn(scene: Scene, logical: DrawnLogicalScenario) -> Scenario:
    """Return the scenario that a scene of a stock environment holds. Its vehicles drive themselves."""
    changed = [mover.name for mover in scene.movers if mover.is_changed]
    if scene.scenario is None:
        raise InputError(f"This scene of {logical.name} lacks the property behavexplor:scenario, its random draws")
    if changed or len(scene.movers) != scene.n_vehicles:
        what = f"{changed[0]} was changed" if changed else "vehicles were added or removed"
        raise InputError(
            f"The vehicles of {logical.name} drive themselves, so their motion cannot be given: {what}; export the "
            "scene again"
        )
    logical.check(scene.scenario)
    return scene.scenario


def _check_ego(ego: Mover, ranges: ScriptedLogicalScenario) -> None:
    """Check that the ego is the environment's, and starts where it always does."""
    start = ranges.roadmap.start_pose
    if math.dist(ego.pose[0, :2], start[:2]) > _SAME or ego.speed > _SAME:
        raise InputError(f"The start of the ego cannot be changed: in {ranges.name} it always stands at the same place")
    if np.abs(np.array(ego.size) - EGO_SIZE).max() > _SAME:
        raise InputError(f"The bounding box of the ego cannot be changed: it is {EGO_SIZE[0]} x {EGO_SIZE[1]} m")


def _npc(mover: Mover, ranges: ScriptedLogicalScenario) -> NPC:
    if mover.type not in ranges.vehicle_types:
        raise InputError(f"{mover.name}: {unknown_name('vehicle type', mover.type, ranges.vehicle_types)}")
    length, width = VEHICLE_SIZES[mover.type]
    if max(abs(mover.size[0] - length), abs(mover.size[1] - width)) > _SAME:
        raise InputError(f"{mover.name}: a {mover.type} is {length} x {width} m: choose another type of vehicle")
    if mover.time[0] > 0 or mover.is_gone:
        raise InputError(
            f"{mover.name} appears or leaves during the scene, but scripted vehicles are there all the time"
        )
    if mover.script is not None and not mover.is_changed:
        return mover.script
    if len(mover.time) < 2:
        raise InputError(
            f"{mover.name}: its start, route or speed profile was changed, and it has no trajectory: change its "
            "properties behavexplor:route and behavexplor:waypoints instead"
        )
    return replace(fitted_script(mover, ranges), type=mover.type)
