"""A learned policy as a driving system under test, with the weights of its network as plain arrays."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.learned.choosing import Decisions, decide, draw_decisions
from behavexplor.ads.learned.mlp import as_network, evaluate_batch
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
from behavexplor.ads.scene_io import ACTION, OBSERVATION, as_actions, as_memory, as_scenes
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scene import EGO, N_COLUMNS, PRESENT
from behavexplor.errors import InputError
from behavexplor.jit import compiled_for, kernel_in_place

Floats = NDArray[np.float64]

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
        self._kernels = CourseKernels(make_course(roadmap))
        widths = [N_FEATURES, *(len(bias) for _, bias in network.layers)]
        shapes = [(weights.shape, bias.shape) for weights, bias in network.layers]
        expected = [((after, before), (after,)) for before, after in pairwise(widths)]
        if shapes != expected or widths[-1] != N_ACTIONS:
            raise InputError(f"Expected a network of {N_FEATURES} inputs and {N_ACTIONS} outputs, got {shapes}")
        self._network = as_network(network.layers)
        self._rule = network.rule

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
        scenes, memory, preferences = self._preferences(observation, state, episode_start)
        return self._kernels.track(scenes, decide(preferences, self._rule), memory), memory

    def draw(
        self, observation: Floats, state: Floats | None, episode_start: NDArray[np.bool_] | None, noise: Floats
    ) -> tuple[Floats, Floats]:
        """Draw the actions of a batch of egos; see `behavexplor.ads.interface.StochasticADS`."""
        scenes, memory, preferences = self._preferences(observation, state, episode_start)
        return self._kernels.track(scenes, draw_decisions(preferences, noise[:, 0]), memory), memory

    def log(self, state: Floats) -> Mapping[str, Floats]:
        """Return the offset of the ego's wanted lane from the route [m], shape (B,)."""
        return {"wanted_offset": state[:, WANTED]}

    def _preferences(
        self, observation: Floats, state: Floats | None, episode_start: NDArray[np.bool_] | None
    ) -> tuple[Floats, Floats, Floats]:
        """Return scenes, memory and preferences, shape (B, N_ACTIONS); those of an absent ego mean nothing."""
        scenes = as_scenes(observation)
        memory = as_memory(state, episode_start, (len(scenes), N_MEMORIES))
        is_present = scenes[:, EGO, PRESENT] != 0.0
        return scenes, memory, evaluate_batch(self._network, self._kernels.see(scenes, memory), is_present)


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
        commands = np.zeros((len(scenes), 2))
        self._track_all(self._course, scenes, decisions, memory, commands)
        return as_actions(commands)


@kernel_in_place
def _see_all(course: Course, scenes: Floats, memory: Floats, seen: Floats) -> None:
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] == 0.0:
            continue
        if memory[i, STARTED] == 0.0:
            begin(course, scenes[i], memory[i])
        see(course, scenes[i], memory[i, WANTED], seen[i])


@kernel_in_place
def _track_all(course: Course, scenes: Floats, decisions: Decisions, memory: Floats, commands: Floats) -> None:
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] != 0.0:
            commands[i, 0], commands[i, 1] = track(
                course, scenes[i], decisions.accelerations[i], decisions.lanes[i], memory[i]
            )
