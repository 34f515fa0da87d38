"""Weaknesses that the planner can be given, and profiles: named sets of them.

Each weakness is one that the paper found in a real system (section IV-B2), under the paper's name. It is nothing
but parameters; a planner without any is the careful one.
"""

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from behavexplor.ads.rule.parameters import Parameters
from behavexplor.ads.rule.planner import RulePlanner
from behavexplor.errors import InputError, unknown_name
from behavexplor.roadmap import RoadMap


@dataclass(frozen=True)
class Weakness:
    """What a planner does wrong.

    Attributes:
        description: in one sentence.
        parameters: the values that make it do so.
    """

    description: str
    parameters: MappingProxyType[str, float]


WEAKNESSES = MappingProxyType(
    {
        "R1-2": Weakness(
            "Vehicles slower than 2 m/s are taken for standing ones; their motion is not predicted.",
            MappingProxyType({"static_speed": 2.0}),
        ),
        "R1-8": Weakness(
            "Before a junction every vehicle is predicted to go straight on, until it has clearly turned.",
            MappingProxyType({"branch_turn": 0.3}),
        ),
    }
)
PROFILES = MappingProxyType({"hardened": (), "apollo-easy": tuple(WEAKNESSES)})
DEFAULT = "apollo-easy"


def rule_planner(roadmap: RoadMap, variant: str = "") -> RulePlanner:
    """The planner with the weaknesses of a variant.

    Args:
        roadmap: the map that it drives by.
        variant: a profile, the default one if empty, then weaknesses to add to it or to take from it, such as
            "hardened+R1-2" or "apollo-easy~R1-8".

    Raises:
        InputError: if there is no such profile or weakness.
    """
    profile, *changes = variant.replace("+", "\0+").replace("~", "\0~").split("\0")
    if (profile or DEFAULT) not in PROFILES:
        raise unknown_name("profile of the rule planner", profile, PROFILES)
    active = set(PROFILES[profile or DEFAULT])
    for change in changes:
        name = change[1:]
        if name not in WEAKNESSES:
            raise unknown_name("weakness of the rule planner", name, WEAKNESSES)
        if (name in active) == (change[0] == "+"):
            raise InputError(f"{change}: the weakness is {'already on' if change[0] == '+' else 'not on'}")
        active ^= {name}
    values: dict[str, Any] = {}
    for name in active:
        values |= WEAKNESSES[name].parameters
    return RulePlanner(roadmap, Parameters(**values))
