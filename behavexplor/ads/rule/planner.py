"""The rule planner: prediction, decision, path, speed and control for a batch of egos."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.road.path import Path, ego_path
from behavexplor.ads.rule.control import PERIOD
from behavexplor.ads.rule.cycle import plan_once
from behavexplor.ads.rule.option import Surroundings
from behavexplor.ads.rule.parameters import Numbers, Parameters, numbers
from behavexplor.ads.rule.prediction import LaneGraph, lane_graph
from behavexplor.ads.rule.speed_search import empty_nodes
from behavexplor.ads.rule.station_time import empty_station_time
from behavexplor.ads.rule.traffic import N_MEMORIES, N_OTHER_COLUMNS, as_records
from behavexplor.ads.scene_io import ACTION, OBSERVATION, as_memory, as_scenes, fill_action
from behavexplor.data.array_types import Floats
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scene import EGO, N_COLUMNS, PRESENT
from behavexplor.jit import compiled_for, kernel

_LOGGED: Final = ("decision", "maneuver", "lane", "survived", "reached", "triggered")
_STORED_NAMES: Final = MappingProxyType({"maneuver": "manoeuvre"})  # the key in stored traces


class RulePlanner:
    """A planner of rules and search that drives the ego's route among other vehicles.

    Attributes:
        observation: `{"type": "Scene"}`, see `behavexplor.data.scene`.
        action: acceleration and steering, each in [-1, 1] over its range.
        policy_frequency: decisions per second, 10 Hz.

    Args:
        roadmap: road map with the ego's route.
        parameters: numbers of the planner, weaknesses included.
    """

    observation: Mapping[str, Any] = OBSERVATION
    action: Mapping[str, Any] = ACTION
    policy_frequency: int = round(1 / PERIOD)
    vectorized: bool = True

    def __init__(self, roadmap: RoadMap, parameters: Parameters = Parameters()) -> None:  # noqa: B008
        self.roadmap = roadmap
        self.parameters = parameters
        self._path = ego_path(roadmap, parameters.lateral_acceleration, parameters.approach_braking)
        self._graph = lane_graph(roadmap, self._path)
        self._numbers = numbers(parameters)
        scenes, memories = np.zeros((1, 1, N_COLUMNS)), as_records(np.zeros((1, N_MEMORIES)))
        self._plan_batch: Any = compiled_for(
            _plan_batch, self._path, self._graph, scenes, memories, self._numbers, np.empty((1, 2))
        )

    def predict(
        self,
        observation: Floats,
        state: Floats | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Floats, Floats]:
        """Decide for a batch of egos.

        Args:
            observation: scenes, shape (B, 1 + n, 8), see `behavexplor.data.scene`.
            state: state returned by the last call, shape (B, 29); None at first.
            episode_start: True for each row that begins an episode, shape (B,); None if no row does.
            deterministic: ignored; the planner is always deterministic.

        Returns:
            Acceleration and steering, shape (B, 2), each in [-1, 1], and the state for the next call.

        Raises:
            InputError: if an array has the wrong shape.
        """
        scenes = as_scenes(observation)
        rows = as_memory(state, episode_start, (len(scenes), N_MEMORIES))
        actions = np.empty((len(scenes), 2))
        self._plan_batch(self._path, self._graph, scenes, as_records(rows), self._numbers, actions)
        return actions, rows

    def log(self, state: Floats) -> Mapping[str, Floats]:
        """Return the last decisions, from the state that `predict` returned.

        Returns:
            Arrays of shape (B,): `decision`, the code of `behavexplor.ads.rule.decision`; `manoeuvre`, the code of
            `behavexplor.ads.rule.lane_choice`; `lane`, where 0 is the route's lane and 1 the next to the right;
            `survived`, the time for which the plan was free of contact [s]; `reached` and `triggered`, bits of the
            weaknesses, see `behavexplor.data.decision_log.weakness_names`.
        """
        memories = as_records(np.ascontiguousarray(state))
        return {_STORED_NAMES.get(name, name): memories[name] for name in _LOGGED}


@kernel
def _plan_batch(
    path: Path, graph: LaneGraph, scenes: Floats, memories: NDArray[np.record], p: Numbers, actions: Floats
) -> None:
    """Make a decision for each ego that is present, and fill in the actions of all."""
    graph = LaneGraph(graph.lanes.copy(), graph.tails, graph.around, graph.beside)  # the spare lane is overwritten
    n_npcs = scenes.shape[1] - 1
    room, nodes = empty_station_time(n_npcs), empty_nodes()
    others = np.empty((n_npcs, N_OTHER_COLUMNS))
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] != 0.0:
            plan_once(Surroundings(path, graph, scenes[i], others, room, nodes, p), memories[i])
        fill_action(memories[i].last_acceleration, memories[i].last_steering, actions[i])
