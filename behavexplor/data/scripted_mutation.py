"""Mutations of scenarios (paper Algorithm 2). A mutant is a valid scenario that differs from its parent."""

from collections.abc import Callable
from functools import partial

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.data.scripted_ranges import ScriptedRanges
from behavexplor.errors import InputError

_ATTEMPTS = 1000


def mutate_waypoints(
    scenario: ScriptedScenario,
    logical: ScriptedRanges,
    rng: np.random.Generator,
    *,
    keep_probability: float,
    sigma_position: float,
    sigma_speed: float,
    point_keep_probability: float = 0.0,
) -> ScriptedScenario:
    """Mutate a scenario by Gaussian noise on the waypoints of some NPCs. Routes and types stay unchanged.

    Args:
        scenario: the parent, valid in `logical`.
        logical: logical scenario with the lanes, the speed range and the spawn rules.
        rng: random generator.
        keep_probability: epsilon, the probability that an NPC stays unchanged.
        sigma_position: standard deviation of the noise on positions [m].
        sigma_speed: standard deviation of the noise on speeds [m/s].
        point_keep_probability: probability that a waypoint of a chosen NPC stays unchanged.

    Raises:
        InputError: if no mutant was found.
    """

    def shifted(npc: NPC) -> NPC:
        return shift_waypoints(npc, logical, rng, (sigma_position, sigma_speed), point_keep_probability)

    return _mutate(scenario, logical, rng, keep_probability, shifted)


def mutate_routes(
    scenario: ScriptedScenario, logical: ScriptedRanges, rng: np.random.Generator, *, keep_probability: float
) -> ScriptedScenario:
    """Mutate a scenario by a new type, a new route and new uniform waypoints for some NPCs.

    Args:
        scenario: the parent, valid in `logical`.
        logical: logical scenario from which the new NPCs are sampled.
        rng: random generator.
        keep_probability: epsilon, the probability that an NPC stays unchanged.

    Raises:
        InputError: if no mutant was found.
    """

    def replaced(_: NPC) -> NPC:
        return logical.sample_npc(rng)

    return _mutate(scenario, logical, rng, keep_probability, replaced)


def shift_waypoints(
    npc: NPC, logical: ScriptedRanges, rng: np.random.Generator, sigma: tuple[float, float], keep_probability: float
) -> NPC:
    """Return an NPC with Gaussian noise on its waypoints, regardless of other vehicles.

    A waypoint stays in its lane. Waypoints on one lane that overtook each other are sorted. Speeds stay in their range,
    and the last one stays 0.

    Args:
        npc: an NPC that is valid in `logical`.
        logical: logical scenario with the lanes and the speed range.
        rng: random generator.
        sigma: standard deviations of the noise on positions [m] and on speeds [m/s].
        keep_probability: probability that a waypoint gets no noise.
    """
    low, high = logical.position_ranges(logical.roadmap.routes[npc.route]).T
    values = np.array([(waypoint.position, waypoint.speed) for waypoint in npc.waypoints])
    noise = rng.normal(0.0, sigma, values.shape)
    noisy = values + noise * (rng.random((len(values), 1)) >= keep_probability)
    position = np.sort(_clipped(noisy[:, 0], low, high))
    position = np.maximum.accumulate(_clipped(position, low, high))
    speed = _clipped(noisy[:, 1], *logical.speed_range)
    speed[-1] = 0.0
    return NPC(npc.type, npc.route, tuple(map(Waypoint, position.tolist(), speed.tolist())))


def _clipped(values: Floats, low: Floats | float, high: Floats | float) -> Floats:
    """Return what `np.clip` returns, which takes ten times as long for a few numbers."""
    return np.minimum(np.maximum(values, low), high)


def _mutate(
    scenario: ScriptedScenario,
    logical: ScriptedRanges,
    rng: np.random.Generator,
    keep_probability: float,
    change: Callable[[NPC], NPC],
) -> ScriptedScenario:
    """Change each NPC with probability 1 - epsilon, and place it beside the other NPCs by the spawn rules."""
    for _ in range(_ATTEMPTS):
        npcs = list(scenario.npcs)
        for i in np.flatnonzero(rng.random(len(npcs)) > keep_probability):
            others = npcs[:i] + npcs[i + 1 :]
            npcs[i] = logical.place(partial(change, npcs[i]), others)
        mutant = ScriptedScenario(scenario.functional, tuple(npcs))
        if mutant != scenario:
            return mutant
    raise InputError(f"None of {_ATTEMPTS} mutations changed a scenario with {len(scenario.npcs)} NPCs")
