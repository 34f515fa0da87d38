"""Concrete scenarios of scripted vehicles: their routes, and their speeds along these routes.

A `ScriptedScenario` is a frozen value that knows neither map nor simulator. A
`behavexplor.data.scripted_logical.ScriptedLogicalScenario` defines which scenarios are possible on a map.
"""

import json
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self

from behavexplor.data.untrusted import object_fields
from behavexplor.errors import InputError, brief

MAX_NAME_LENGTH = 200  # characters
MAX_NUMBER = 1e9  # limit of positions [m] and speeds [m/s]


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A position along a route and the speed at this position.

    Attributes:
        position: distance from the start of the route [m], >= 0.
        speed: speed at this position [m/s], >= 0.

    Raises:
        InputError: if a value is not a number from 0 to `MAX_NUMBER`.
    """

    position: float
    speed: float

    def __post_init__(self) -> None:
        position, speed = self.position, self.speed
        if type(position) is float is type(speed) and 0.0 <= position < MAX_NUMBER and 0.0 <= speed < MAX_NUMBER:
            return  # nearly always
        object.__setattr__(self, "position", _number("position", position))
        object.__setattr__(self, "speed", _number("speed", speed))


@dataclass(frozen=True, slots=True)
class NPC:
    """A scripted vehicle that follows its waypoints blindly and parks at the last one.

    Attributes:
        type: vehicle type, such as "sedan".
        route: name of the vehicle's route.
        waypoints: one or more waypoints with non-decreasing positions. The vehicle starts at the first one.

    Raises:
        InputError: if a field has the wrong type, or the positions decrease.
    """

    type: str
    route: str
    waypoints: tuple[Waypoint, ...]

    def __post_init__(self) -> None:
        _text("type", self.type)
        _text("route", self.route)
        object.__setattr__(self, "waypoints", _parts("waypoints", self.waypoints))
        if not self.waypoints:
            raise InputError("waypoints: at least one is needed")
        for i, waypoint in enumerate(self.waypoints):
            if not isinstance(waypoint, Waypoint):
                raise InputError(f"waypoints[{i}]: expected a Waypoint, got {brief(waypoint)}")
        positions = [waypoint.position for waypoint in self.waypoints]
        for i, (before, position) in enumerate(pairwise(positions), 1):
            if position < before:
                raise InputError(f"waypoints[{i}].position: {position} lies before the previous waypoint's {before}")


@dataclass(frozen=True, slots=True)
class ScriptedScenario:
    """A concrete scenario, in which all values are fixed.

    Attributes:
        functional: name of the functional scenario, such as "intersection-straight".
        npcs: the scripted vehicles.

    Raises:
        InputError: if a field has the wrong type.
    """

    functional: str
    npcs: tuple[NPC, ...]

    def __post_init__(self) -> None:
        _text("functional", self.functional)
        object.__setattr__(self, "npcs", _parts("npcs", self.npcs))
        for i, npc in enumerate(self.npcs):
            if not isinstance(npc, NPC):
                raise InputError(f"npcs[{i}]: expected an NPC, got {brief(npc)}")

    @property
    def has_original(self) -> bool:
        """False: the roads are this package's."""
        return False

    @property
    def meta_actions(self) -> tuple[()]:
        """Nothing: the driver accelerates and steers."""
        return ()

    @property
    def conditions(self) -> dict[str, Any]:
        """Nothing: the script holds in every configuration of the environment."""
        return {}

    @property
    def scene_config(self) -> dict[str, Any]:
        """Nothing, as for `conditions`."""
        return {}

    @property
    def scene(self) -> Self:
        """The whole scenario, which is the same for every driver."""
        return self

    def to_dict(self) -> dict[str, Any]:
        """Return the scenario as JSON values. Waypoints are `[position, speed]` pairs."""
        return {
            "functional": self.functional,
            "npcs": [
                {
                    "type": npc.type,
                    "route": npc.route,
                    "waypoints": [[waypoint.position, waypoint.speed] for waypoint in npc.waypoints],
                }
                for npc in self.npcs
            ],
        }

    def to_json(self) -> str:
        """Return the scenario as one line of JSON. `behavexplor.data.scenario.parse_scenario` restores it exactly."""
        return json.dumps(self.to_dict(), separators=(",", ":"))

    @classmethod
    def from_dict(cls, value: object) -> Self:
        """Create a scenario from JSON values, as returned by `to_dict`.

        Raises:
            InputError: if a field is missing, unknown or wrong; the message names it.
        """
        fields = object_fields("the scenario", value, ("functional", "npcs"))
        npcs = []
        for i, entry in enumerate(_list("npcs", fields["npcs"])):
            npcs.append(_within(f"npcs[{i}]", _npc_from_dict, entry))
        return cls(fields["functional"], tuple(npcs))


def _npc_from_dict(value: object) -> NPC:
    fields = object_fields("an NPC", value, ("type", "route", "waypoints"))
    waypoints = []
    for i, pair in enumerate(_list("waypoints", fields["waypoints"])):
        waypoints.append(_within(f"waypoints[{i}]", _waypoint_from_pair, pair))
    return NPC(fields["type"], fields["route"], tuple(waypoints))


def _waypoint_from_pair(value: object) -> Waypoint:
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"expected [position, speed], got {brief(value)}")
    return Waypoint(*value)


def _within(place: str, read: Any, value: object) -> Any:
    """Read a nested value. If it is wrong, the error names the whole path to the field."""
    try:
        return read(value)
    except InputError as error:
        message = str(error)
        separator = "." if re.match(r"\w+(\[|\.|:)", message) else ": "
        raise InputError(f"{place}{separator}{message}") from None


def _list(name: str, value: object) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"{name}: expected a list, got {value!r:.80}")
    return value


def _parts(name: str, value: Any) -> tuple[Any, ...]:
    if not isinstance(value, Iterable):
        raise InputError(f"{name}: expected a list, got {value!r:.80}")
    return tuple(value)


def _text(name: str, value: object) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= MAX_NAME_LENGTH:
        raise InputError(f"{name}: expected a name, got {value!r:.80}")
    return value


def _number(name: str, value: object) -> float:
    number = math.nan
    if isinstance(value, int | float) and not isinstance(value, bool):
        number = float(value) if abs(value) < MAX_NUMBER else math.inf
    if not 0 <= number < math.inf:
        raise InputError(f"{name}: expected a number from 0 to {MAX_NUMBER:g}, got {value!r:.80}")
    return number
