"""Profiles: named sets of weaknesses with their severities.

`hardened` has no weakness. `apollo-like` has all sixteen, so mild that all failures together are about as rare as in
the paper's experiments (docs/planner.md). It is frozen: its numbers do not change any more, so that results stay
comparable. `apollo-held-back` is the same profile with every severity 30 % up or down, but no share beyond its greatest
value, to check that a conclusion does not depend on the exact numbers. `apollo-easy` has all sixteen, so severe that
failures occur at once. It is the default.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from behavexplor.ads.rule.parameters import Parameters
from behavexplor.ads.rule.planner import RulePlanner
from behavexplor.ads.rule.weaknesses import WEAKNESSES
from behavexplor.data.roadmap import RoadMap
from behavexplor.errors import InputError, unknown_name

APOLLO_LIKE = MappingProxyType(
    {
        "R1-1": 0.02,
        "R1-2": 1.0,
        "R1-3": 1.5,
        "R1-4": 4.0,
        "R1-5": 0.1,
        "R1-6": 0.9,
        "R1-7": 0.8,
        "R1-8": 0.08,
        "R2-1": 0.2,
        "R2-2": 0.2,
        "R2-3": 0.8,
        "R2-4": 1.2,
        "R3-1": 1.0,
        "R3-2": 0.02,
        "R3-3": 0.6,
        "R3-4": 0.15,
    }
)
_NONE: Final[Mapping[str, float]] = MappingProxyType({})
# Severity alone does not make these six rare enough, so their gates are narrower here.
_RARE_GATES = MappingProxyType(
    {
        "occlusion_beyond": 40.0,
        "branch_speed": 9.0,
        "cut_in_below": 3.0,
        "short_change_below": 1.6,
        "no_room_below": 1.5,
        "deadlock_after": 15.0,
    }
)
APOLLO_EASY = MappingProxyType(
    {
        "R1-1": 0.8,
        "R1-2": 2.0,
        "R1-3": 4.0,
        "R1-4": 6.0,
        "R1-5": 0.95,
        "R1-6": 1.0,
        "R1-7": 1.0,
        "R1-8": 0.3,
        "R2-1": 0.45,
        "R2-2": 0.45,
        "R2-3": 3.0,
        "R2-4": 1.5,
        "R3-1": 4.0,
        "R3-2": 0.5,
        "R3-3": 0.9,
        "R3-4": 1.5,
    }
)
_MOST: Final = MappingProxyType(  # greatest severities of the weaknesses whose severity is a share
    {"R1-1": 1.0, "R1-5": 1.0, "R1-6": 1.0, "R1-7": 1.0, "R2-1": 1.0, "R2-2": 0.9, "R3-2": 1.0, "R3-3": 1.0}
)
_HELD_BACK = MappingProxyType(
    {
        name: min(severity * (1.3 if i % 2 else 0.7), _MOST.get(name, severity * 1.3))
        for i, (name, severity) in enumerate(APOLLO_LIKE.items())
    }
)
DEFAULT: Final = "apollo-easy"


@dataclass(frozen=True)
class Profile:
    """A set of weaknesses."""

    severities: Mapping[str, float]  # severities by the names of the weaknesses
    gates: Mapping[str, float]  # other parameters that differ from those of the careful planner


PROFILES = MappingProxyType(
    {
        "hardened": Profile(_NONE, _NONE),
        "apollo-like": Profile(APOLLO_LIKE, _RARE_GATES),
        "apollo-held-back": Profile(_HELD_BACK, _RARE_GATES),
        "apollo-easy": Profile(APOLLO_EASY, _NONE),
    }
)


def rule_planner(roadmap: RoadMap, variant: str = "") -> RulePlanner:
    """Make the planner with the weaknesses of a variant.

    Args:
        roadmap: road map with the ego's route.
        variant: name of a profile, the default one if empty, followed by weaknesses to add or to remove, such as
            "hardened+R1-2" or "apollo-like~R2-1". An added weakness is as severe as in `apollo-easy`.

    Raises:
        InputError: if the profile or a weakness does not exist, or a weakness is already on or not on.
    """
    return RulePlanner(roadmap, Parameters(**variant_parameters(variant)))


def variant_parameters(variant: str) -> dict[str, float]:
    """Return the numbers of a variant that differ from the careful planner's, by field of `Parameters`.

    See `rule_planner` for the form of a variant.

    Raises:
        InputError: if the profile or a weakness does not exist, or a weakness is already on or not on.
    """
    profile, *changes = re.split(r"(?=[+~])", variant)  # before each sign
    if (profile or DEFAULT) not in PROFILES:
        raise unknown_name("profile of the rule planner", profile, PROFILES)
    base = PROFILES[profile or DEFAULT]
    severities = dict(base.severities)
    for change in changes:
        sign, name = change[0], change[1:]
        if name not in WEAKNESSES:
            raise unknown_name("weakness of the rule planner", name, WEAKNESSES)
        if (name in severities) == (sign == "+"):
            raise InputError(f"{change}: the weakness is {'already on' if sign == '+' else 'not on'}")
        if sign == "+":
            severities[name] = APOLLO_EASY[name]
        else:
            del severities[name]
    return {WEAKNESSES[name].parameter: severity for name, severity in severities.items()} | dict(base.gates)
