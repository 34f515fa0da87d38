"""The rule planner: prediction, decision, path, speed and control, asked for a batch of egos."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.rule.control import ACCELERATION_RANGE, PERIOD, STEERING_RANGE, accelerate, steer
from behavexplor.ads.rule.decision import (
    EMERGENCY,
    YIELD,
    can_wait,
    crosses_freely,
    decision_code,
    passed,
    waiting_station,
)
from behavexplor.ads.rule.parameters import Numbers, Parameters, numbers
from behavexplor.ads.rule.path import Path, ego_path, project_on_path
from behavexplor.ads.rule.prediction import LaneGraph, lane_graph
from behavexplor.ads.rule.speed import Nodes, Situation, empty_nodes, plan_speed
from behavexplor.ads.rule.station_time import INTERVAL, StationTime, empty_station_time, project_obstacles
from behavexplor.compiled import kernel
from behavexplor.errors import InputError
from behavexplor.roadmap import RoadMap
from behavexplor.scene import EGO, LENGTH, N_COLUMNS, SPEED, X, Y

Floats = NDArray[np.float64]

RESOLUTION: Final = 1e-9  # of what is observed, so that simulators that differ in the last bits see the same drive

DECISION: Final = 0  # code, see `behavexplor.ads.rule.decision`
CLEAR: Final = 1  # how long the junction has been free [s]
LAST_ACCELERATION: Final = 2  # commanded [m/s2]
LAST_STEERING: Final = 3  # commanded [rad]
SURVIVED: Final = 4  # how long the plan is free of contact [s]
N_MEMORIES: Final = 5  # columns of the state; all zero at the start of an episode


class RulePlanner:
    """A planner of rules and search that drives the ego's route of a map among others.

    Attributes:
        observation: `{"type": "Scene"}`, see `behavexplor.scene`.
        action: acceleration and steering, each in [-1, 1] over its range.
        policy_frequency: 10 Hz.
    """

    observation: Mapping[str, Any] = MappingProxyType({"type": "Scene"})
    action: Mapping[str, Any] = MappingProxyType(
        {
            "type": "ContinuousAction",
            "acceleration_range": list(ACCELERATION_RANGE),
            "steering_range": list(STEERING_RANGE),
        }
    )
    policy_frequency: int = round(1 / PERIOD)

    def __init__(self, roadmap: RoadMap, parameters: Parameters = Parameters()) -> None:  # noqa: B008
        self.roadmap = roadmap
        self.parameters = parameters
        self._path = ego_path(roadmap, parameters)
        self._graph = lane_graph(roadmap.npc_routes, roadmap.ego_route)
        self._numbers = numbers(parameters)

    def predict(
        self,
        observation: Floats,
        state: Floats | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Floats, Floats]:
        """Decide for a batch of egos.

        Args:
            observation: scenes, shape (B, 1 + n, 8), see `behavexplor.scene`.
            state: what the last call returned, shape (B, 5); None at first.
            episode_start: whether a row begins an episode, shape (B,); None for no row.
            deterministic: it always is.

        Returns:
            Acceleration and steering, shape (B, 2), each in [-1, 1], and the state to hand in next time.

        Raises:
            InputError: if an array has a wrong shape.
        """
        scenes = np.asarray(observation, dtype=np.float64)
        if scenes.ndim != 3 or scenes.shape[1] == 0 or scenes.shape[2] != N_COLUMNS:
            raise InputError(f"observation: expected shape (B, 1 + n, {N_COLUMNS}), got {scenes.shape}")
        scenes = np.ascontiguousarray(np.rint(scenes / RESOLUTION) * RESOLUTION)
        memory = np.zeros((len(scenes), N_MEMORIES)) if state is None else np.array(state, dtype=np.float64, order="C")
        if memory.shape != (len(scenes), N_MEMORIES):
            raise InputError(f"state: expected shape {(len(scenes), N_MEMORIES)}, got {memory.shape}")
        if episode_start is not None:
            memory[np.asarray(episode_start, dtype=bool)] = 0.0
        _plan_batch(self._path, self._graph, scenes, memory, self._numbers)
        commands = memory[:, [LAST_ACCELERATION, LAST_STEERING]]
        low, high = np.array([ACCELERATION_RANGE, STEERING_RANGE]).T
        return 2 * (commands - low) / (high - low) - 1, memory

    def log(self, state: Floats) -> Mapping[str, Floats]:
        """The last decisions, from the state that `predict` returned.

        Returns:
            `decision`, the code of `behavexplor.ads.rule.decision`, shape (B,), and `survived`, how long the
            plan was free of contact, shape (B,) [s].
        """
        return {"decision": state[:, DECISION], "survived": state[:, SURVIVED]}


@kernel
def _plan_batch(path: Path, graph: LaneGraph, scenes: Floats, memory: Floats, p: Numbers) -> None:
    graph = LaneGraph(graph.lanes.copy(), graph.tails, graph.near)  # the spare lane is written to
    room, nodes = empty_station_time(scenes.shape[1] - 1), empty_nodes()
    for i in range(len(scenes)):
        _plan(path, graph, scenes[i], memory[i], p, room, nodes)


@kernel
def _plan(
    path: Path, graph: LaneGraph, scene: Floats, memory: Floats, p: Numbers, room: StationTime, nodes: Nodes
) -> None:
    """One decision; the commands are left in the memory."""
    speed, half_length, last = scene[EGO, SPEED], scene[EGO, LENGTH] / 2, memory[LAST_ACCELERATION]
    station, _ = project_on_path(path, scene[EGO, X], scene[EGO, Y])
    project_obstacles(path, graph, scene, station, p, room)

    waits = can_wait(path, station, speed, half_length, p)
    caution = 1.0 if waits or passed(path, station, half_length) else p.committed_caution
    plan = plan_speed(Situation(path, room, half_length, math.inf, caution, p), station, speed, last, nodes)
    yields = False
    if waits:
        crosses = crosses_freely(path, room, plan, half_length)
        memory[CLEAR] = memory[CLEAR] + PERIOD if crosses else 0.0
        yields = not crosses or (memory[DECISION] == YIELD and memory[CLEAR] < p.clear_time)
    if yields:
        wall = waiting_station(path, station, speed, half_length, p)
        waiting = plan_speed(Situation(path, room, half_length, wall, caution, p), station, speed, last, nodes)
        if waiting.survived >= plan.survived:
            plan = waiting

    memory[DECISION] = decision_code(path, plan, station, half_length, yields)
    memory[SURVIVED] = plan.survived * INTERVAL
    at_once = memory[DECISION] == EMERGENCY or plan.acceleration < -p.firm_braking
    memory[LAST_ACCELERATION] = accelerate(plan.acceleration, last, speed, at_once, p)
    memory[LAST_STEERING] = steer(path, scene, station, memory[LAST_STEERING], p)
