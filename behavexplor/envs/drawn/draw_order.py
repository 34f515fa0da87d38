"""The order in which an environment makes its draws."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from highway_env.envs import IntersectionEnv
from numpy.typing import NDArray

from behavexplor.data.drawn_logical import NORMAL, UNIFORM
from behavexplor.data.drawn_scenario import DrawnScenario
from behavexplor.envs.drawn.drawn_env import DrawnEnv
from behavexplor.envs.drawn.generator import DrawnGenerator

Floats = NDArray[np.float64]

SPAWN = "_spawn_vehicle"
_SPAWN_KINDS = (UNIFORM, UNIFORM, UNIFORM, NORMAL, NORMAL)  # of its draws, before that of `DELTA`


class Place(NamedTuple):
    """Where a draw is found: its call, its position among the call's draws, and its kind."""

    name: str
    position: int
    kind: str


def start_order(env: DrawnEnv, scenarios: Iterable[DrawnScenario]) -> tuple[Place, ...] | None:
    """Return the order of the draws with which episodes begin; None if it differs from episode to episode.

    Args:
        env: the environment; its episodes are used up.
        scenarios: scenarios whose episodes are compared.
    """
    orders = set()
    for scenario in scenarios:
        env.begin_blindly(scenario)
        orders.add(_with_whole_spawns(Place(*place) for place in env.generator.sequence))
    return orders.pop() if len(orders) == 1 else None


def decision_order(env: DrawnEnv) -> tuple[Place, ...]:
    """Return the order of the draws after each decision, by which vehicles appear at an intersection."""
    if not isinstance(env.inner, IntersectionEnv):
        return ()
    decisions = math.ceil(env.config["duration"] * env.config["policy_frequency"]) + 1
    calls = [f"step#{decision}/{SPAWN}" if decision else f"step/{SPAWN}" for decision in range(decisions)]
    return tuple(place for call in calls for place in _spawn(call))


def forms_of(scenario: DrawnScenario, order: Sequence[Place]) -> Floats:
    """Return the standard forms of a scenario's draws in their order, shape (n,)."""
    draws: dict[str, Any] = dict(scenario.draws)
    made = DrawnGenerator(draws, scenario.seed, __file__)
    given = ((draws.get(place.name, ()), place) for place in order)
    return np.array(
        [known[place.position] if place.position < len(known) else made.form(*place) for known, place in given]
    )


def _with_whole_spawns(places: Iterable[Place]) -> tuple[Place, ...]:
    """Return an order in which each call that may place a vehicle at an intersection has all draws it might make."""
    order: list[Place] = []
    seen = set()
    for place in places:
        caller, found, rest = place.name.partition(f"/{SPAWN}")
        if not found:
            order.append(place)
            continue
        call = f"{caller}{found}{rest.partition('/')[0]}"
        order += [] if call in seen else _spawn(call)
        seen.add(call)
    return tuple(order)


def _spawn(call: str) -> list[Place]:
    own = [Place(call, position, kind) for position, kind in enumerate(_SPAWN_KINDS)]
    return [*own, Place(f"{call}/randomize_behavior", 0, UNIFORM)]
