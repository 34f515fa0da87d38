"""Concrete scenarios, in which all values are fixed.

There are two kinds: scripted vehicles on one of this package's roads (`behavexplor.data.scripted`), and the random
draws of a highway-env environment (`behavexplor.data.drawn_scenario`).
"""

from collections.abc import Hashable, Mapping
from typing import Any, Protocol

from behavexplor.data.drawn_scenario import DrawnScenario
from behavexplor.data.scripted import NPC, ScriptedScenario
from behavexplor.data.untrusted import parse_json


class Scenario(Protocol):
    """A concrete scenario: a frozen value, which can be compared, hashed and stored."""

    @property
    def functional(self) -> str:
        """Name of the functional scenario, or of the highway-env environment."""
        ...

    @property
    def npcs(self) -> tuple[NPC, ...]:
        """The scripted vehicles; none where all vehicles drive themselves."""
        ...

    @property
    def has_original(self) -> bool:
        """Whether the scenario belongs to one of highway-env's environments, so that highway-env itself can run it."""
        ...

    @property
    def meta_actions(self) -> tuple[str, ...]:
        """The names of the driver's actions by index, if they are highway-env's meta-actions; otherwise nothing."""
        ...

    @property
    def conditions(self) -> Mapping[str, Any]:
        """The fields of a `behavexplor.data.target.Target` that the scenario itself states."""
        ...

    @property
    def scene_config(self) -> Mapping[str, Any]:
        """The configuration of the environment that the scenario itself states, but for what a driver declares."""
        ...

    @property
    def scene(self) -> Hashable:
        """What is the same in the scenario for every driver."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Return the scenario as JSON values, from which `read_scenario` restores it exactly."""
        ...

    def to_json(self) -> str:
        """Return the scenario as one line of JSON, from which `parse_scenario` restores it exactly."""
        ...

    def __hash__(self) -> int: ...


def read_scenario(value: object) -> Scenario:
    """Create a scenario of either kind from JSON values, as returned by `to_dict`.

    Raises:
        InputError: if a field is missing, unknown or wrong; the message names it.
    """
    if isinstance(value, dict) and "draws" in value:
        return DrawnScenario.from_dict(value)
    return ScriptedScenario.from_dict(value)


def parse_scenario(text: str) -> Scenario:
    """Create a scenario of either kind from JSON, as returned by `to_json`.

    Raises:
        InputError: if the text is too long or not JSON, or a field is wrong; the message names the field.
    """
    return read_scenario(parse_json(text, "a scenario"))
