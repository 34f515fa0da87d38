"""A synthetic landscape with two planted optima: an ADS in a few lines that fails where it was made to.

The ego drives straight past the NPCs, which stand beside its way. How near each of them stands (R1) depends on a few
parameters of that NPC; how near the ego comes to a line (R2) on one parameter of all of them. It slows down beside
whatever is near, so behaviors tell how near a violation is, and runs take longer there.
"""

import numpy as np

from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.trace import Trace
from behavexplor.envs.functional import IntersectionStraightEnv

LOGICAL = IntersectionStraightEnv.logical

STEP = 0.25  # [s]
SPEED = 9.0  # of the ego where nothing is near [m/s]
FIRST, SPACING = 25.0, 25.0  # where NPCs stand along the way [m]
LENGTH = FIRST + SPACING * LOGICAL.n_npcs
SLOPES = 8.0, 8.0  # meters of distance for the whole range of the parameters
RADII = 0.05, 0.02  # of the optima, as shares of it
EARLY_SPEEDS, LATE_SPEED = (6.0, 6.0, 6.0), 9.5  # where they lie [m/s]
RANGE = LOGICAL.roadmap.speed_limit


def npc_gap(npc):
    """How far beside the way an NPC stands [m]: 0 if it turns left and drives at 6 m/s at its first waypoints."""
    speeds = np.array([waypoint.speed for waypoint in npc.waypoints[: len(EARLY_SPEEDS)]])
    apart = np.sqrt(np.mean(((speeds - EARLY_SPEEDS) / RANGE) ** 2))
    other_route = 0.0 if npc.route.endswith("left") else 0.5
    return SLOPES[0] * max(apart + other_route - RADII[0], 0.0)


def line_gap(scenario):
    """How far from the ego a line is [m]: 0 if the NPCs drive at 9.5 m/s on average at their fifth waypoint."""
    late = np.mean([npc.waypoints[4].speed for npc in scenario.npcs])
    return SLOPES[1] * max(abs(late - LATE_SPEED) / RANGE - RADII[1], 0.0)


def simulate(scenario):
    gaps = np.array([npc_gap(npc) for npc in scenario.npcs])
    places = FIRST + SPACING * np.arange(len(gaps))
    x = np.concatenate([[0.0], np.cumsum(_speeds(gaps, places) * STEP)])
    x = np.minimum(x[: np.searchsorted(x, LENGTH) + 1], LENGTH)
    sizes = np.array([EGO_SIZE, *(VEHICLE_SIZES[npc.type] for npc in scenario.npcs)])
    beside = np.where(gaps > 0, gaps + (sizes[0, 1] + sizes[1:, 1]) / 2, 0.0)
    contacts = [place for place, offset in zip(places, beside, strict=True) if offset == 0]
    if contacts:
        x = x[: np.searchsorted(x, contacts[0] - 3.0) + 1]
    position = np.zeros((len(x), len(sizes), 2))
    position[:, 0, 0] = x
    position[:, 1:, 0], position[:, 1:, 1] = places, beside
    velocity = np.zeros_like(position)
    velocity[:, 0, 0] = np.gradient(x, STEP)
    side = -EGO_SIZE[1] / 2 - line_gap(scenario)
    return Trace(
        time=np.arange(len(x)) * STEP,
        position=position,
        heading=np.zeros(position.shape[:2]),
        velocity=velocity,
        size=sizes,
        actions=np.zeros((0, 1)),
        action_frame=np.zeros(0, dtype=int),
        route=np.array([[0.0, 0.0], [LENGTH + 10, 0.0]]),
        destination=np.array([LENGTH, 0.0]),
        illegal_lines=np.array([[[0.0, side], [LENGTH, side]]]),
        end="collision" if contacts else "arrived",
    )


def _speeds(gaps, places):
    """The ego's speed in each step [m/s]: less beside an NPC the nearer that stands."""
    speeds, x = [], 0.0
    while x < LENGTH:
        near = np.abs(places - x) < SPACING / 2
        gap = gaps[near].min(initial=np.inf)
        speeds.append(SPEED * min(0.25 + gap / 6, 1.0))
        x += speeds[-1] * STEP
    return np.array(speeds)
