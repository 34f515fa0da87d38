"""The rule planner: prediction, decision, path, speed and control for a batch of egos."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.road.path import Path, ego_path, pose_on_path, project_on_path
from behavexplor.ads.rule import lane_choice
from behavexplor.ads.rule.control import PERIOD, LateralProfile, accelerate, change_profile, keep_profile, steer
from behavexplor.ads.rule.decision import CREEP, EMERGENCY, STANDING, YIELD, creep, decision_code
from behavexplor.ads.rule.lane_choice import EgoState
from behavexplor.ads.rule.memory import N_MEMORIES, Memory, as_records
from behavexplor.ads.rule.option import Option, Surroundings, plan_option
from behavexplor.ads.rule.parameters import Numbers, Parameters, numbers
from behavexplor.ads.rule.prediction import LaneGraph, lane_graph
from behavexplor.ads.rule.speed_search import empty_nodes
from behavexplor.ads.rule.station_time import INTERVAL, N_INTERVALS, empty_station_time
from behavexplor.ads.rule.traffic import N_OTHER_COLUMNS, locate
from behavexplor.ads.rule.weaknesses import R1_4, R1_5, R1_6, R2_2, R3_2, R3_3, TRIGGERED, note
from behavexplor.ads.scene_io import ACTION, OBSERVATION, as_memory, as_scenes, fill_action
from behavexplor.data.array_types import Bools, Floats
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scene import EGO, HEADING, LENGTH, N_COLUMNS, PRESENT, SPEED, WIDTH, X, Y
from behavexplor.jit import compiled_for, kernel, kernel_inner

HARD_LIMIT: Final = 8.0  # full braking [m/s2]
SUDDEN_TIME: Final = 3.0  # time of weak braking after another vehicle's sudden change of speed (R1-4) [s]
STRONGER: Final = 2.0  # additional acceleration of short lane changes at severity 1 (R2-2) [m/s2]
SHARP_WAY: Final = 20.0  # distance from the start of a short lane change to usual steering and acceleration (R2-2) [m]
STUCK: Final = 1.0  # time of standing in a lane change after which the ego decides anew [s]
CREEP_ACCELERATION: Final = 1.2  # acceleration while creeping [m/s2]
_LOGGED: Final = ("decision", "maneuver", "lane", "survived", "reached", "triggered")
_STORED_NAMES: Final = MappingProxyType({"maneuver": "manoeuvre"})  # the key in stored traces


class RulePlanner:
    """A planner of rules and search that drives the ego's route in traffic.

    Args:
        roadmap: road map with the ego's route.
        parameters: numbers of the planner, weaknesses included.
    """

    observation: Mapping[str, Any] = OBSERVATION  # `{"type": "Scene"}`, see `behavexplor.data.scene`
    action: Mapping[str, Any] = ACTION  # acceleration and steering, each in [-1, 1] over its range
    policy_frequency: int = round(1 / PERIOD)  # decisions per second, 10 Hz
    vectorized: bool = True

    def __init__(self, roadmap: RoadMap, parameters: Parameters = Parameters()) -> None:  # noqa: B008
        self.roadmap = roadmap
        self.parameters = parameters
        self._path = ego_path(roadmap, parameters.lateral_acceleration, parameters.approach_braking)
        self._ways = lane_graph(roadmap, self._path)
        self._numbers = numbers(parameters)
        scenes, memories = np.zeros((1, 1, N_COLUMNS)), as_records(np.zeros((1, N_MEMORIES)))
        self._plan_batch: Any = compiled_for(
            _plan_batch, self._path, self._ways, scenes, memories, self._numbers, np.empty((1, 2))
        )

    def predict(
        self,
        observation: Floats,
        state: Floats | None = None,
        episode_start: Bools | None = None,
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Floats, Floats]:
        """Decide for a batch of egos; see `behavexplor.ads.interface.ADS`.

        Args:
            observation: scenes, shape (B, 1 + n, 8), see `behavexplor.data.scene`.
            state: state returned by the last call, shape (B, N_MEMORIES); None in the first call.
            episode_start: True for each row that begins an episode, shape (B,); None if no row does.
            deterministic: without effect. The planner is always deterministic.

        Returns:
            Acceleration and steering, shape (B, 2), each in [-1, 1], and the state for the next call.

        Raises:
            InputError: if an array has the wrong shape.
        """
        scenes = as_scenes(observation)
        rows = as_memory(state, episode_start, (len(scenes), N_MEMORIES))
        actions = np.empty((len(scenes), 2))
        self._plan_batch(self._path, self._ways, scenes, as_records(rows), self._numbers, actions)
        return actions, rows

    def log(self, state: Floats) -> Mapping[str, Floats]:
        """Return the last decisions, from the state that `predict` returned.

        They are arrays of shape (B,): `decision`, the code of `behavexplor.ads.rule.decision`; `manoeuvre`, the code of
        `behavexplor.ads.rule.lane_choice`; `lane`, where 0 is the route's lane and 1 the next to the right; `survived`,
        the time for which the plan was free of contact [s]; `reached` and `triggered`, bits of the weaknesses, see
        `behavexplor.data.trace.weakness_names`.
        """
        memories = as_records(np.ascontiguousarray(state))
        return {_STORED_NAMES.get(name, name): memories[name] for name in _LOGGED}


@kernel
def _plan_batch(
    path: Path, shared_ways: LaneGraph, scenes: Floats, memories: NDArray[np.record], p: Numbers, actions: Floats
) -> None:
    """Make a decision for each ego that is present, and fill in the actions of all."""
    lanes = shared_ways.lanes.copy()  # the spare one is overwritten
    ways = LaneGraph(lanes, shared_ways.tails, shared_ways.around, shared_ways.beside)
    n_npcs = scenes.shape[1] - 1
    station_time, nodes = empty_station_time(n_npcs), empty_nodes()
    others = np.empty((n_npcs, N_OTHER_COLUMNS))
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] != 0.0:
            plan_once(Surroundings(path, ways, scenes[i], others, station_time, nodes, p), memories[i])
        fill_action(memories[i].last_acceleration, memories[i].last_steering, actions[i])


@kernel_inner
def plan_once(world: Surroundings, memory: Memory) -> None:
    """Make one decision: plan the speed, begin or abort a lane change if needed, and leave commands in the memory."""
    path, scene, bits = world.path, world.scene, world.st_graph.bits
    bits[:] = 0
    station, offset = project_on_path(path, scene[EGO, X], scene[EGO, Y])
    ego = EgoState(station, offset, max(scene[EGO, SPEED], 0.0), scene[EGO, LENGTH] / 2, scene[EGO, WIDTH] / 2)
    locate(path, scene, world.others)
    _remember(path, ego, memory)
    option = plan_option(world, ego, _present_profile(path, memory), int(memory.lane), memory)
    if memory.change_length > 0.0:
        option = _abort_if_needed(world, ego, option, memory)
    else:
        option = _change_if_wanted(world, ego, option, memory)
    _settle(world, ego, option, memory)
    memory.reached, memory.triggered = bits[0], bits[1]


@kernel_inner
def _remember(path: Path, ego: EgoState, memory: Memory) -> None:
    """Update the memory with the ego's motion since the last decision."""
    if memory.started == 0.0:
        memory.started = 1.0
        memory.lane = memory.origin = round(ego.offset / path.lane_width)
    memory.since += PERIOD
    ended = ego.station >= memory.change_start + memory.change_length
    if memory.stood > STUCK:  # it may stand in the target lane before the end of the change
        ended = ended or abs(ego.offset - memory.lane * path.lane_width) < path.lane_width / 2
    if memory.change_length > 0.0 and ended:
        memory.change_length = memory.since = memory.ignores = 0.0
        memory.maneuver = lane_choice.KEEP
    if ego.station > memory.change_start + SHARP_WAY:
        memory.sharp = 0.0
    if memory.lane == 0.0 and memory.change_length == 0.0:
        memory.overrun = memory.overtaking = 0.0
    memory.stood = memory.stood + PERIOD if ego.speed < STANDING else 0.0
    memory.waited = memory.waited + PERIOD if ego.speed < STANDING and memory.decision == YIELD else 0.0
    memory.restarted = max(memory.restarted - PERIOD, 0.0)


@kernel_inner
def _present_profile(path: Path, memory: Memory) -> LateralProfile:
    last = memory.lane * path.lane_width
    if memory.change_length == 0.0:
        return keep_profile(last)
    return LateralProfile(memory.change_start, memory.change_length, memory.change_offset, memory.change_slope, last)


@kernel_inner
def _is_safe(option: Option) -> bool:
    return option.plan.survived == N_INTERVALS and option.plan.risk == 0.0


@kernel_inner
def _change_if_wanted(world: Surroundings, ego: EgoState, present: Option, memory: Memory) -> Option:
    """Begin a lane change if another lane is better and its gaps are accepted."""
    path, others, p, bits = world.path, world.others, world.p, world.st_graph.bits
    lane = int(memory.lane)
    option, begun = present, False
    wrong = lane_choice.wrong_side(path, others, ego, memory, bits, p)
    if wrong != lane:
        option, begun = _try_change(world, ego, present, wrong, memory)
    wanted = lane if begun else lane_choice.choose_lane(path, others, ego, memory, bits, p)
    if bits[TRIGGERED] & R3_3:
        memory.overrun = 1.0
    if wanted != lane:
        option, begun = _try_change(world, ego, present, wanted, memory)
    return option


@kernel_inner
def _try_change(
    world: Surroundings, ego: EgoState, present: Option, wanted: int, memory: Memory
) -> tuple[Option, bool]:
    """Return the change to a lane if it is safe, else the present option; and whether the change is begun."""
    path, p, bits = world.path, world.p, world.st_graph.bits
    lane = int(memory.lane)
    if not lane_choice.accepts_gap(path, world.others, ego, wanted, bits, p):
        return present, False
    length = lane_choice.change_length(ego.speed, p)
    sharp = p.short_change > 0.0 and ego.speed < p.short_change_below
    if sharp:
        note(bits, R2_2, True)
        length *= 1.0 - p.short_change
    profile = change_profile(ego.station, ego.offset, _slope(world, ego), wanted * path.lane_width, length)
    option = plan_option(world, ego, profile, wanted, memory)
    if not _is_safe(option):
        if not lane_choice.cuts_in(ego, p) or option.plan.survived < N_INTERVALS // 2:
            return plan_option(world, ego, present.profile, lane, memory), False
        note(bits, R1_5, True)
    memory.maneuver, memory.origin = lane_choice.CHANGE, lane
    if abs(wanted) > abs(lane):
        memory.maneuver = lane_choice.OVERTAKE
        memory.overtaking = 1.0
        memory.overrun = 1.0 if bits[TRIGGERED] & R3_2 else 0.0
    memory.sharp = 1.0 if sharp else 0.0
    _adopt(profile, wanted, memory)
    return option, True


@kernel_inner
def _abort_if_needed(world: Surroundings, ego: EgoState, present: Option, memory: Memory) -> Option:
    """Return to the original lane if a vehicle comes close in the target lane, and returning is possible and helps.

    It is possible while the ego's center is still in the original lane.
    """
    path, p, bits = world.path, world.p, world.st_graph.bits
    lane, origin = int(memory.lane), int(memory.origin)
    inside = abs(ego.offset - origin * path.lane_width) < path.lane_width / 2
    share = lane_choice.gap_share(path, world.others, ego, lane, p)
    alarm = present.plan.survived * INTERVAL < p.abort_time
    if memory.maneuver == lane_choice.ABORT or not inside or not (alarm or share < p.abort_share):
        return present
    if p.no_abort > 0.0:
        goes_on = share >= (1.0 - p.no_abort) * p.abort_share
        note(bits, R1_6, goes_on)
        if goes_on:
            memory.ignores = 1.0
            return present
    length = lane_choice.change_length(ego.speed, p)
    profile = change_profile(ego.station, ego.offset, _slope(world, ego), origin * path.lane_width, length)
    option = plan_option(world, ego, profile, origin, memory)
    if option.plan.survived < present.plan.survived:
        return plan_option(world, ego, present.profile, lane, memory)
    memory.maneuver, memory.origin = lane_choice.ABORT, memory.lane
    _adopt(profile, origin, memory)
    return option


@kernel_inner
def _slope(world: Surroundings, ego: EgoState) -> float:
    """Return the slope of the ego's motion relative to its route."""
    _, _, along = pose_on_path(world.path, ego.station)
    return math.tan(min(max(math.sin(world.scene[EGO, HEADING] - along), -0.5), 0.5))


@kernel_inner
def _adopt(profile: LateralProfile, lane: int, memory: Memory) -> None:
    memory.lane = lane
    memory.change_start, memory.change_length = profile.start, profile.length
    memory.change_offset, memory.change_slope = profile.first, profile.slope


@kernel_inner
def _settle(world: Surroundings, ego: EgoState, option: Option, memory: Memory) -> None:
    """Store the decision and its commands in the memory."""
    path, p, bits, plan = world.path, world.p, world.st_graph.bits, option.plan
    memory.clear = memory.clear + PERIOD if option.crosses else 0.0
    memory.decision = decision_code(path, plan, ego.station, ego.half_length, option.yields)
    memory.survived = plan.survived * INTERVAL
    acceleration = plan.acceleration
    if creep(world.st_graph, ego.station, option.limit, memory, bits, p) and memory.decision != EMERGENCY:
        memory.creeps -= PERIOD
        memory.decision = CREEP
        acceleration = CREEP_ACCELERATION
    if p.weak_braking > 0.0:
        memory.weakened = SUDDEN_TIME if bits[TRIGGERED] & R1_4 else max(memory.weakened - PERIOD, 0.0)
        if memory.weakened > 0.0:
            acceleration = max(acceleration, p.weak_braking - HARD_LIMIT)
    if memory.sharp == 1.0 and acceleration > 0.0:
        note(bits, R2_2, True)
        acceleration = p.comfortable_acceleration + STRONGER * p.short_change
    at_once = memory.decision == EMERGENCY or acceleration < -p.firm_braking
    memory.last_acceleration = accelerate(acceleration, memory.last_acceleration, ego.speed, at_once, p)
    memory.last_steering = steer(path, option.profile, world.scene, ego.station, memory, bits, p)
