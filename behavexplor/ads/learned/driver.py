"""A learned policy as a driving system under test, with the weights of its network as plain arrays."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.learned.choosing import ACCELERATION_TABLE, DRAWN, MEAN, MOST_PROBABLE, Decisions, choose
from behavexplor.ads.learned.mlp import DenseNetwork, as_network, evaluate
from behavexplor.ads.learned.network_file import TrainedNetwork
from behavexplor.ads.learned.observation import N_FEATURES, see
from behavexplor.ads.learned.route_table import Course, make_course
from behavexplor.ads.learned.tracker import (
    N_ACTIONS,
    N_MEMORIES,
    PERIOD,
    STARTED,
    WANTED,
    begin,
    track,
)
from behavexplor.ads.scene_io import ACTION, OBSERVATION, as_memory, as_scenes, fill_action
from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scene import EGO, N_COLUMNS, PRESENT
from behavexplor.errors import InputError
from behavexplor.jit import compiled_for, kernel_in_place, kernel_inner

POLICY_FREQUENCY: Final = round(1 / PERIOD)


class LearnedDriver:
    """A driver whose network sees conflicts and gaps and chooses an acceleration and a lane, which a tracker follows.

    Attributes:
        observation: `{"type": "Scene"}`, see `behavexplor.data.scene`.
        action: acceleration and steering, each in [-1, 1] over its range.
        policy_frequency: decisions per second, 5 Hz.
        vectorized: True, because each row is decided independently.
        noise: see `behavexplor.ads.interface.StochasticADS`.

    Args:
        roadmap: road map with the ego's route.
        network: network whose outputs are the preferences of the actions. Between two layers tanh is applied.

    Raises:
        InputError: if the layers do not fit each other, or the numbers of features and actions.
    """

    observation: Mapping[str, Any] = OBSERVATION
    action: Mapping[str, Any] = ACTION
    policy_frequency: int = POLICY_FREQUENCY
    vectorized: bool = True
    noise: int = 1

    def __init__(self, roadmap: RoadMap, network: TrainedNetwork) -> None:
        self._course = make_course(roadmap)
        widths = [N_FEATURES, *(len(bias) for _, bias in network.layers)]
        shapes = [(weights.shape, bias.shape) for weights, bias in network.layers]
        expected = [((after, before), (after,)) for before, after in pairwise(widths)]
        if shapes != expected or widths[-1] != N_ACTIONS:
            raise InputError(f"Expected a network of {N_FEATURES} inputs and {N_ACTIONS} outputs, got {shapes}")
        self._network = as_network(network.layers)
        self._how = MEAN if network.rule == "mean" else MOST_PROBABLE
        self._widest = max(widths)
        scenes, memory, shares = np.zeros((1, 1, N_COLUMNS)), np.zeros((1, N_MEMORIES)), np.zeros(1)
        rooms, rows, actions = np.empty((2, 1, self._widest)), np.empty(1, dtype=np.int64), np.zeros((1, 2))
        tables = (self._course, self._network, ACCELERATION_TABLE)
        self._drive_all: Any = compiled_for(
            _drive_all, *tables, scenes, memory, self._how, shares, rooms, rows, actions
        )

    def predict(
        self,
        observation: Floats,
        state: Floats | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,  # noqa: ARG002 - `draw` draws
    ) -> tuple[Floats, Floats]:
        """Decide for a batch of egos; see `behavexplor.ads.interface.ADS`.

        Args:
            observation: scenes, shape (B, 1 + n, 8), see `behavexplor.data.scene`.
            state: state returned by the last call, shape (B, 3); None at first.
            episode_start: True for each row that begins an episode, shape (B,); None if no row does.
            deterministic: ignored; nothing is drawn.

        Returns:
            Acceleration and steering, shape (B, 2), each in [-1, 1], and the state for the next call.

        Raises:
            InputError: if an array has the wrong shape.
        """
        return self._drive(observation, state, episode_start, None)

    def draw(
        self, observation: Floats, state: Floats | None, episode_start: NDArray[np.bool_] | None, noise: Floats
    ) -> tuple[Floats, Floats]:
        """Draw the actions of a batch of egos; see `behavexplor.ads.interface.StochasticADS`."""
        return self._drive(observation, state, episode_start, np.array(noise[:, 0], dtype=np.float64))

    def log(self, state: Floats) -> Mapping[str, Floats]:
        """Return the offset of the ego's wanted lane from the route [m], shape (B,)."""
        return {"wanted_offset": state[:, WANTED]}

    def _drive(
        self,
        observation: Floats,
        state: Floats | None,
        episode_start: NDArray[np.bool_] | None,
        shares: Floats | None,
    ) -> tuple[Floats, Floats]:
        """Return the actions, shape (B, 2), and the memory. The action of an absent ego is 0.

        Args:
            observation: see `predict`.
            state: see `predict`.
            episode_start: see `predict`.
            shares: numbers in [0, 1) by which the actions are drawn, shape (B,); None for the network's own rule.
        """
        scenes = as_scenes(observation)
        memory = as_memory(state, episode_start, (len(scenes), N_MEMORIES))
        how, shares = (self._how, np.zeros(len(scenes))) if shares is None else (DRAWN, shares)
        rooms, rows = np.empty((2, len(scenes), self._widest)), np.empty(len(scenes), dtype=np.int64)
        actions = np.zeros((len(scenes), 2))
        tables = (self._course, self._network, ACCELERATION_TABLE)
        self._drive_all(*tables, scenes, memory, how, shares, rooms, rows, actions)
        return actions, memory


class CourseKernels:
    """What policies see of a batch of scenes, and the commands for their decisions, computed by machine code.

    Args:
        course: route table, see `behavexplor.ads.learned.route_table`.
    """

    def __init__(self, course: Course) -> None:
        self._course = course
        scenes, memory, seen = np.zeros((1, 1, N_COLUMNS)), np.zeros((1, N_MEMORIES)), np.zeros((1, N_FEATURES))
        decisions = Decisions(np.zeros(1), np.zeros(1, dtype=np.int64))
        self._see_all = compiled_for(_see_all, course, scenes, memory, seen)
        self._track_all = compiled_for(_track_all, course, scenes, decisions, memory, np.zeros((1, 2)))

    def see(self, scenes: Floats, memory: Floats) -> Floats:
        """Compute the features that policies see, shape (B, N_FEATURES).

        Args:
            scenes: scenes, contiguous, shape (B, 1 + n, 8), see `behavexplor.data.scene`.
            memory: memory of each ego, contiguous, shape (B, 3). A row of zeros begins an episode; it is changed in
                place.
        """
        seen = np.zeros((len(scenes), N_FEATURES))
        self._see_all(self._course, scenes, memory, seen)
        return seen

    def track(self, scenes: Floats, decisions: Decisions, memory: Floats) -> Floats:
        """Compute the commands for policies' decisions, shape (B, 2), each in [-1, 1] over its range.

        Args:
            scenes: scenes, contiguous, shape (B, 1 + n, 8), see `behavexplor.data.scene`.
            decisions: decisions of the policies.
            memory: memory of each ego, contiguous, shape (B, 3), changed in place.
        """
        actions = np.zeros((len(scenes), 2))
        self._track_all(self._course, scenes, decisions, memory, actions)
        return actions


@kernel_in_place
def _see_all(course: Course, scenes: Floats, memory: Floats, seen: Floats) -> None:
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] != 0.0:
            _see(course, scenes[i], memory[i], seen[i])


@kernel_in_place
def _drive_all(  # noqa: PLR0913, PLR0917 - a tuple of them would be copied in each call
    course: Course,
    network: DenseNetwork,
    accelerations: Floats,
    scenes: Floats,
    memory: Floats,
    how: int,
    shares: Floats,
    rooms: Floats,
    rows: Ints,
    actions: Floats,
) -> None:
    """Fill in the actions of the egos that are present. `rooms` and `rows` are for intermediate results."""
    count = 0
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] != 0.0:
            _see(course, scenes[i], memory[i], rooms[0, i, :N_FEATURES])
            rows[count] = i
            count += 1
    outputs = evaluate(network, rooms, rows[:count])
    for i in rows[:count]:
        wanted, lane = choose(rooms[outputs, i, :N_ACTIONS], accelerations, how, shares[i])
        _track(course, scenes[i], wanted, lane, memory[i], actions[i])


@kernel_inner
def _see(course: Course, scene: Floats, memory: Floats, seen: Floats) -> None:
    if memory[STARTED] == 0.0:
        begin(course, scene, memory)
    see(course, scene, memory[WANTED], seen)


@kernel_in_place
def _track_all(course: Course, scenes: Floats, decisions: Decisions, memory: Floats, actions: Floats) -> None:
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] != 0.0:
            _track(course, scenes[i], decisions.accelerations[i], decisions.lanes[i], memory[i], actions[i])


@kernel_inner
def _track(course: Course, scene: Floats, wanted: float, lane: int, memory: Floats, action: Floats) -> None:
    acceleration, steering = track(course, scene, wanted, lane, memory)
    fill_action(acceleration, steering, action)
