"""Witnesses: commands with which the ego would have avoided a collision. Anyone can replay them.

NPCs do not react to the ego, so their motion stays the same and a witness is exact. A witness drives as recorded up to
some time and deviates from then on. It touches no vehicle until `SURVIVED` after the recorded collision, and no illegal
line after the deviation. The driver models are those of UN Regulation 157 (annex 4, appendix 3), and milder and harsher
ones.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from behavexplor.data.array_types import Bools, Floats, Ints
from behavexplor.data.geometry import box_corners, boxes_overlap, project_on_polyline
from behavexplor.data.scenario import Scenario
from behavexplor.data.scene import EGO, HEADING, LENGTH, SPEED, X, Y
from behavexplor.data.scripted_logical import require_scripted
from behavexplor.data.trace import Trace
from behavexplor.execution.rollout import rollout_all
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.events import ViolationEvent, first_line_touch
from behavexplor.triage.closed_loop import ScriptedDriver
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

MAX_ACCELERATION: Final = 10.0  # greatest acceleration and deceleration that `ACTION` can command [m/s2]
MAX_STEERING: Final = math.pi / 3  # greatest steering angle to either side that `ACTION` can command [rad]
MOVING: Final = 1e-3  # below this speed, the steering has no effect and cannot be recovered [m/s]

OBSERVATION: Final[Mapping[str, Any]] = MappingProxyType({"type": "Scene"})
ACTION: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "type": "ContinuousAction",
        "acceleration_range": [-MAX_ACCELERATION, MAX_ACCELERATION],
        "steering_range": [-MAX_STEERING, MAX_STEERING],
    }
)

SPACING: Final = 0.25  # distance between points of a path [m]
BEYOND: Final = 60.0  # straight extension of a path at its end [m]
BACK, AHEAD = 8, 16  # points behind and ahead of the last nearest point among which the next one is searched for
LOOK_AHEAD: Final = 2.5  # look-ahead distance of the steering at standstill [m]
LOOK_AHEAD_TIME: Final = 0.25  # growth of the look-ahead distance with the speed [s]
STEERING: Final = 0.6  # greatest steering angle of an evasion [rad]
STEERING_RATE: Final = 0.8  # greatest change of an evasion's steering angle [rad/s]
LATERAL: Final = 5.0  # greatest lateral acceleration that an evasion steers for [m/s2]


@dataclass(frozen=True)
class Evasion:
    """Driving as recorded up to some time, then braking, accelerating, or moving to the side."""

    name: str  # kind of evasion, for people
    begin: float  # time up to which the ego drives as recorded [s]
    acceleration: float  # desired acceleration at first [m/s2]
    lasting: float = math.inf  # duration of the first acceleration [s]
    then: float = 0.0  # desired acceleration afterwards [m/s2]
    jerk: float = math.inf  # limit of the change of the acceleration [m/s3]
    offset: float = 0.0  # lateral move to the right of the path [m]
    swing: float = 2.0  # duration of the lateral move [s]

    @property
    def effort(self) -> float:
        """Severity of the evasion, lower is milder."""
        return max(abs(self.acceleration), abs(self.then)) + 2 * abs(self.offset)


def find_witness(
    simulation: Simulation, scenario: Scenario, trace: Trace, event: ViolationEvent, rng: np.random.Generator
) -> tuple[Witness | None, int]:
    """Search for a witness of a collision: by models of drivers, the mildest first, then by random evasions.

    Return the witness, or None if no evasion avoids the collision; and the number of evasions that were tried, 0 if the
    environment cannot run in lock-step. The ADS of the simulation is not used.
    """
    tried = 0
    for batch in range(1 + SAMPLES // BATCH):
        evasions = [drawn(trace, rng) for _ in range(BATCH)] if batch else modeled(trace, event)
        path = path_beside_route(trace) if batch else path_straight_on(trace)
        driven = drive(simulation, scenario, trace, evasions, path)
        tried += len(driven)
        good = [i for i, other in enumerate(driven) if avoids(other, trace, evasions[i].begin)]
        if good:
            best = good[0] if batch == 0 else min(good, key=lambda i: evasions[i].effort)
            chosen, commands = evasions[best], recorded_commands(driven[best])
            return Witness(chosen.name, chosen.begin, frequency(trace), commands), tried
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
    actions = as_actions(witness.commands)[None]  # of one ego, shape (1, D, 2)
    (_, trace), *_ = rollout_all(envs, ScriptedDriver(actions), [scenario])
    envs.close()
    return trace


def drive(
    simulation: Simulation, scenario: Scenario, trace: Trace, evasions: Sequence[Evasion], path: Floats
) -> list[Trace]:
    """Drive evasions along a path, up to `SURVIVED` after the recorded end.

    Return the trace of each evasion; none if the environment cannot run in lock-step.
    """
    rate = frequency(trace)
    envs = simulation.vector_env(len(evasions), **_config(rate, trace.duration + SURVIVED))
    if envs is None:
        return []
    driver = EvasionDriver(
        trace, evasions, path, require_scripted(simulation.logical, "An evasion").roadmap.speed_limit
    )
    ended = dict(rollout_all(envs, driver, [scenario] * len(evasions)))
    envs.close()
    return [ended[row] for row in range(len(evasions))]


def _config(rate: int, seconds: float) -> dict[str, Any]:
    return {
        "observation": dict(OBSERVATION),
        "action": dict(ACTION),
        "policy_frequency": rate,
        "simulation_frequency": rate,
        "duration": round(seconds * rate) / rate,
    }


def modeled(trace: Trace, event: ViolationEvent) -> list[Evasion]:
    """Return the evasions of driver models, the mildest first."""
    alarm, end = alarm_time(trace, event), float(trace.time[event.frame])
    earlier = [Evasion(ANTICIPATION, max(end - before, 0.0), -ANTICIPATING) for before in ANTICIPATED]
    careful = Evasion(CAREFUL, min(alarm + DELAY, end), -CAREFUL_BRAKING, jerk=CAREFUL_JERK)
    return [careful, Evasion(IDEAL, alarm, -IDEAL_BRAKING), *earlier]


def drawn(trace: Trace, rng: np.random.Generator) -> Evasion:
    """Draw a random evasion: two accelerations in succession and, with probability 1/2, a lateral move."""
    end = trace.duration
    return Evasion(
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
    frames = np.arange(max(event.frame - round(EARLIEST * frequency(trace)), 0), event.frame + 1)
    pair = [0, event.partner]
    position, velocity = trace.position[frames][:, pair], trace.velocity[frames][:, pair]
    ahead = np.arange(0.0, ALARM + 1e-9, 0.1)[:, None, None, None]  # too fine for boxes to pass each other unnoticed
    boxes = box_corners(position + ahead * velocity, trace.heading[frames][:, pair], trace.size[pair])
    conflict = boxes_overlap(boxes[:, :, 0], boxes[:, :, 1]).any(0)
    return float(trace.time[frames[conflict.argmax() if conflict.any() else -1]])


def frequency(trace: Trace) -> int:
    """Return the frequency of the recorded simulation steps [Hz]."""
    return round((len(trace.time) - 1) / trace.duration)


def recorded_commands(trace: Trace) -> Floats:
    """Recover the ego's accelerations [m/s2] and steering angles [rad] from frame to frame, shape (T - 1, 2).

    This inverts `Vehicle.step` of highway-env, so it works for any ADS.
    """
    heading, velocity = trace.heading[:, 0], trace.velocity[:, 0]
    forward = velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading)
    speed = np.copysign(np.hypot(velocity[:, 0], velocity[:, 1]), forward)
    direction = np.copysign(1.0, forward)
    course = np.arctan2(velocity[:, 1] * direction, velocity[:, 0] * direction)
    slip = np.remainder(course - heading + np.pi, 2 * np.pi) - np.pi
    step = np.diff(trace.time)
    moves = np.abs(speed) > MOVING
    turn = np.diff(heading) * trace.size[0, 0] / 2 / np.where(moves[:-1], speed[:-1] * step, np.inf)
    # An ego that has just stopped has no direction of motion. There, the change of its heading shows the steering.
    stopping = np.arcsin(np.clip(turn, -1.0, 1.0))
    used = np.where(moves[1:], slip[1:], stopping)
    return np.stack([np.diff(speed) / step, np.arctan(2 * np.tan(used))], axis=-1)


def as_actions(commands: Floats) -> Floats:
    """Scale accelerations [m/s2] and steering angles [rad], shape (..., 2), to values of `ACTION`."""
    return np.asarray(commands / (MAX_ACCELERATION, MAX_STEERING))


class EvasionDriver:
    """An ADS that drives the egos of a batch, each with an evasion of its own, in the same scenario.

    Row i of the batch is evasion i. The egos accelerate up to `speed_limit` [m/s]. Their common `path` begins with
    that of `trace`; it has points `SPACING` apart, shape (P, 2) [m].
    """

    def __init__(self, trace: Trace, evasions: Sequence[Evasion], path: Floats, speed_limit: float) -> None:
        self._recorded = recorded_commands(trace)
        self._period = float(trace.time[1])
        self._limit = speed_limit
        self._path = path
        columns = ("begin", "acceleration", "lasting", "then", "jerk", "offset", "swing")
        self._plan = {name: np.array([getattr(evasion, name) for evasion in evasions]) for name in columns}
        self._first = np.rint(self._plan["begin"] / self._period).astype(np.int64)
        self._arrival = project_on_polyline(trace.position[:, 0], self._path)[0]

    def predict(
        self,
        observation: Floats,
        state: tuple[int, Floats, Ints] | None = None,
        episode_start: Bools | None = None,  # noqa: ARG002 - all egos begin together
        deterministic: bool = True,  # noqa: ARG002 - evasions are always deterministic
    ) -> tuple[Floats, tuple[int, Floats, Ints]]:
        """Return the commands of all egos. The state holds the step, the last commands and the nearest path points."""
        count = len(observation)
        step, last, place = (0, np.zeros((count, 2)), np.zeros(count, np.int64)) if state is None else state
        commands = np.repeat(self._recorded[[min(step, len(self._recorded) - 1)]], count, axis=0)
        evading = (step >= self._first) | (step >= len(self._recorded))
        if not evading.any():
            place = np.full(count, round(float(self._arrival[step]) / SPACING))
            return as_actions(commands), (step + 1, commands, place)
        ego = observation[:, EGO]
        place = self._nearest(ego, place)
        since = step * self._period - self._plan["begin"]
        evading_commands = np.stack([self._accelerate(ego, since, last), self._steer(ego, since, place, last)], -1)
        commands[evading] = evading_commands[evading]
        return as_actions(commands), (step + 1, commands, place)

    def _nearest(self, ego: Floats, place: Ints) -> Ints:
        """Return the index of the path point nearest to each ego, searched for around the last index, shape (B,)."""
        near = np.clip(place[:, None] + np.arange(-BACK, AHEAD), 0, len(self._path) - 1)
        gap = self._path[near] - ego[:, None, [X, Y]]
        return np.asarray(near[np.arange(len(ego)), (gap**2).sum(-1).argmin(1)])

    def _accelerate(self, ego: Floats, since: Floats, last: Floats) -> Floats:
        """Return the accelerations, shape (B,) [m/s2]. They never lead to a negative speed."""
        plan = self._plan
        wanted = np.where(since < plan["lasting"], plan["acceleration"], plan["then"])
        change = plan["jerk"] * self._period
        wanted = np.clip(wanted, last[:, 0] - change, last[:, 0] + change)
        room = np.maximum(self._limit - ego[:, SPEED], 0.0) / self._period
        return np.maximum(np.minimum(wanted, room), -ego[:, SPEED] / self._period)

    def _steer(self, ego: Floats, since: Floats, place: Ints, last: Floats) -> Floats:
        """Return steering angles by pure pursuit of the path with its offset, shape (B,) [rad]."""
        plan, path, speed = self._plan, self._path, ego[:, SPEED]
        away = LOOK_AHEAD + LOOK_AHEAD_TIME * speed
        there = np.clip(place + np.rint(away / SPACING).astype(np.int64), 1, len(path) - 1)
        along = path[there] - path[there - 1]
        share = np.clip((since + away / np.maximum(speed, 1.0)) / plan["swing"], 0.0, 1.0)
        offset = plan["offset"] * share**3 * (10 - 15 * share + 6 * share**2)
        normal = np.stack([-along[:, 1], along[:, 0]], -1) / SPACING
        gap = path[there] + offset[:, None] * normal - ego[:, [X, Y]]
        bearing = np.arctan2(gap[:, 1], gap[:, 0]) - ego[:, HEADING]
        ratio = ego[:, LENGTH] / np.maximum(np.hypot(gap[:, 0], gap[:, 1]), SPACING)
        wanted = np.arctan(2 * ratio * np.sin(bearing) / (1 + ratio * np.cos(bearing)))
        most = np.minimum(STEERING, np.arctan(LATERAL * ego[:, LENGTH] / np.maximum(speed, 0.1) ** 2))
        change = STEERING_RATE * self._period
        wanted = np.clip(wanted, last[:, 1] - change, last[:, 1] + change)
        return np.asarray(np.clip(wanted, -most, most))


def path_straight_on(trace: Trace) -> Floats:
    """Return the recorded path, extended straight, as points `SPACING` apart, shape (P, 2) [m]."""
    return _spaced(np.concatenate([trace.position[:, 0], _beyond(trace.position[-1, 0], trace.heading[-1, 0])]))


def path_beside_route(trace: Trace) -> Floats:
    """Return the recorded path, extended parallel to the route, as points `SPACING` apart, shape (P, 2) [m]."""
    driven, route = trace.position[:, 0], trace.route
    station, along = project_on_polyline(driven[-1:], route)
    ends = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
    foot = np.array([np.interp(station[0], ends, route[:, i]) for i in range(2)])
    aside = (driven[-1] - foot) @ (-math.sin(along[0]), math.cos(along[0]))
    beyond = route[ends > station[0] + 1.0]
    if not len(beyond):
        return path_straight_on(trace)
    heading = project_on_polyline(beyond, route)[1]
    onward = beyond + aside * np.stack([-np.sin(heading), np.cos(heading)], -1)
    return _spaced(np.concatenate([driven, onward, _beyond(onward[-1], heading[-1])]))


def _beyond(point: Floats, heading: float) -> Floats:
    """Return the point `BEYOND` straight ahead, shape (1, 2) [m]."""
    return np.array([point + BEYOND * np.array([math.cos(heading), math.sin(heading)])])


def _spaced(points: Floats) -> Floats:
    """Resample a polyline at points `SPACING` apart."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    moved = np.concatenate([[True], np.diff(way) > 0])
    stations = np.arange(0.0, way[-1], SPACING)
    return np.stack([np.interp(stations, way[moved], points[moved, i]) for i in range(2)], -1)
