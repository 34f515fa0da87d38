"""Witnesses: commands with which the ego would have avoided a collision. Anyone can replay them.

NPCs do not react to the ego, so their motion stays the same and a witness is exact. A witness drives as recorded up to
some time and deviates from then on. It touches no vehicle until `SURVIVED` after the recorded collision, and no illegal
line after the deviation. The driver models are those of UN Regulation 157 (annex 4, appendix 3), and milder and harsher
ones.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.geometry import box_corners, boxes_overlap
from behavexplor.data.scenario import Scenario
from behavexplor.data.scripted_logical import scripted
from behavexplor.data.trace import Trace
from behavexplor.execution.rollout import rollout_all
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.events import ViolationEvent, first_line_touch
from behavexplor.triage import evasion
from behavexplor.triage.findings import Witness

SURVIVED: Final = 4.0  # time after the recorded collision during which a witness touches no vehicle [s]
SAMPLES: Final = 192  # random evasions that are tried before a collision counts as unpreventable
BATCH: Final = 64  # random evasions driven in lock-step

ALARM: Final = 2.0  # time to collision below which a careful driver reacts [s]
DELAY: Final = 0.75  # reaction time of a careful driver [s]
CAREFUL_BRAKING: Final = 0.774 * 9.81  # [m/s2]
CAREFUL_JERK: Final = 12.65  # [m/s3]
IDEAL_BRAKING: Final = 8.5  # [m/s2]
ANTICIPATING: Final = 4.0  # deceleration of an anticipating driver [m/s2]
ANTICIPATED: Final = (3.0, 3.5, 4.0, 4.5, 5.0)  # times before the collision at which that driver begins to brake [s]
EARLIEST, LATEST = 6.0, 0.3  # range of times before the collision at which random evasions begin [s]
SIDEWAYS: Final = 3.5  # greatest lateral move of a random evasion to either side [m]

CAREFUL, IDEAL, ANTICIPATION, SAMPLED = "careful and competent", "ideal braking", "anticipation", "sampled"


def find_witness(
    simulation: Simulation, scenario: Scenario, trace: Trace, event: ViolationEvent, rng: np.random.Generator
) -> tuple[Witness | None, int]:
    """Search for a witness: first by models of drivers, the mildest first, then by random evasions.

    Args:
        simulation: simulation with the environment of the collision; its ADS is not used.
        scenario: the executed scenario.
        trace: trace of its execution.
        event: violation event of the collision.
        rng: generator for the random evasions.

    Returns:
        The witness, or None if no evasion avoids the collision; and the number of evasions that were tried, 0 if the
        environment cannot run in lock-step.
    """
    tried = 0
    for batch in range(1 + SAMPLES // BATCH):
        evasions = [drawn(trace, rng) for _ in range(BATCH)] if batch else modeled(trace, event)
        path = evasion.path_beside_route(trace) if batch else evasion.path_straight_on(trace)
        driven = drive(simulation, scenario, trace, evasions, path)
        tried += len(driven)
        good = [i for i, other in enumerate(driven) if avoids(other, trace, evasions[i].begin)]
        if good:
            best = good[0] if batch == 0 else min(good, key=lambda i: evasions[i].effort)
            chosen, commands = evasions[best], evasion.recorded_commands(driven[best])
            return Witness(chosen.name, chosen.begin, evasion.frequency(trace), commands), tried
    return None, tried


def avoids(other: Trace, trace: Trace, begin: float) -> bool:
    """Return whether `other`, which deviates from a recorded trace at time `begin` [s], is a witness."""
    if other.end not in ("arrived", "timeout", "standstill"):
        return False
    if other.end != "arrived" and other.duration < trace.duration + SURVIVED - 1e-6:
        return False
    touch = first_line_touch(other)
    return touch is None or bool(other.time[touch.frame] <= begin)  # an earlier touch is in the recorded trace, too


def replay_witness(simulation: Simulation, scenario: Scenario, witness: Witness) -> Trace:
    """Execute a scenario with the commands of a witness.

    Raises:
        ValueError: if the environment cannot run in lock-step.
    """
    seconds = len(witness.commands) / witness.frequency
    envs = simulation.vector_env(1, **_config(witness.frequency, seconds))
    if envs is None:
        raise ValueError("this environment cannot run in lock-step")
    (_, trace), *_ = rollout_all(envs, evasion.Playback(witness.commands), [scenario])
    envs.close()
    return trace


def drive(
    simulation: Simulation, scenario: Scenario, trace: Trace, evasions: Sequence[evasion.Evasion], path: Floats
) -> list[Trace]:
    """Drive evasions along a path, up to `SURVIVED` after the recorded end.

    Returns:
        The trace of each evasion; none if the environment cannot run in lock-step.
    """
    rate = evasion.frequency(trace)
    envs = simulation.vector_env(len(evasions), **_config(rate, trace.duration + SURVIVED))
    if envs is None:
        return []
    driver = evasion.EvasionDriver(
        trace, evasions, path, scripted(simulation.logical, "An evasion").roadmap.speed_limit
    )
    ended = dict(rollout_all(envs, driver, [scenario] * len(evasions)))
    envs.close()
    return [ended[row] for row in range(len(evasions))]


def _config(rate: int, seconds: float) -> dict[str, Any]:
    return {
        "observation": dict(evasion.OBSERVATION),
        "action": dict(evasion.ACTION),
        "policy_frequency": rate,
        "simulation_frequency": rate,
        "duration": round(seconds * rate) / rate,
    }


def modeled(trace: Trace, event: ViolationEvent) -> list[evasion.Evasion]:
    """Return the evasions of driver models, the mildest first."""
    alarm, end = alarm_time(trace, event), float(trace.time[event.frame])
    earlier = [evasion.Evasion(ANTICIPATION, max(end - before, 0.0), -ANTICIPATING) for before in ANTICIPATED]
    careful = evasion.Evasion(CAREFUL, min(alarm + DELAY, end), -CAREFUL_BRAKING, jerk=CAREFUL_JERK)
    return [careful, evasion.Evasion(IDEAL, alarm, -IDEAL_BRAKING), *earlier]


def drawn(trace: Trace, rng: np.random.Generator) -> evasion.Evasion:
    """Draw a random evasion: two accelerations in succession and, with probability 1/2, a lateral move."""
    end = trace.duration
    return evasion.Evasion(
        SAMPLED,
        begin=max(end - float(rng.uniform(LATEST, EARLIEST)), 0.0),
        acceleration=float(rng.uniform(-IDEAL_BRAKING, 3.0)),
        lasting=float(rng.uniform(0.3, 4.0)),
        then=float(rng.uniform(-ANTICIPATING, 3.0)),
        offset=float(rng.uniform(-SIDEWAYS, SIDEWAYS)) if rng.random() < 0.5 else 0.0,
        swing=float(rng.uniform(1.5, 4.0)),
    )


def alarm_time(trace: Trace, event: ViolationEvent) -> float:
    """Return when the time to collision, at constant velocities and headings, first fell below `ALARM` [s]."""
    frames = np.arange(max(event.frame - round(EARLIEST * evasion.frequency(trace)), 0), event.frame + 1)
    pair = [0, event.partner]
    position, velocity = trace.position[frames][:, pair], trace.velocity[frames][:, pair]
    ahead = np.arange(0.0, ALARM + 1e-9, 0.1)[:, None, None, None]  # too fine for boxes to pass each other unnoticed
    boxes = box_corners(position + ahead * velocity, trace.heading[frames][:, pair], trace.size[pair])
    conflict = boxes_overlap(boxes[:, :, 0], boxes[:, :, 1]).any(0)
    return float(trace.time[frames[conflict.argmax() if conflict.any() else -1]])
