"""A learned policy as a driving system under test, with the weights of its network as plain arrays."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.learned.mlp import as_network, decide_batch, draw_batch
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
from behavexplor.data.scene import EGO, PRESENT
from behavexplor.data.untrusted import read_arrays
from behavexplor.errors import InputError
from behavexplor.jit import kernel_in_place

Floats = NDArray[np.float64]

POLICY_FREQUENCY: Final = round(1 / PERIOD)


class LearnedDriver:
    """A driver whose network sees conflicts and gaps and chooses an acceleration and a lane, which a tracker follows.

    Attributes:
        observation: `{"type": "Scene"}`, see `behavexplor.data.scene`.
        action: acceleration and steering, each in [-1, 1] over its range.
        policy_frequency: decisions per second, 5 Hz.
        noise: see `behavexplor.ads.interface.StochasticADS`.

    Args:
        roadmap: road map with the ego's route.
        layers: weights, shape (outputs, inputs), and biases, shape (outputs,), of each layer. Between two layers tanh
            is applied, and the index of the greatest output is the action.

    Raises:
        InputError: if the layers do not fit each other, or the numbers of features and actions.
    """

    observation: Mapping[str, Any] = OBSERVATION
    action: Mapping[str, Any] = ACTION
    policy_frequency: int = POLICY_FREQUENCY
    vectorized: bool = True
    noise: int = 1

    def __init__(self, roadmap: RoadMap, layers: list[tuple[Floats, Floats]]) -> None:
        self._course = make_course(roadmap)
        widths = [N_FEATURES, *(len(bias) for _, bias in layers)]
        shapes = [(weights.shape, bias.shape) for weights, bias in layers]
        expected = [((after, before), (after,)) for before, after in pairwise(widths)]
        if shapes != expected or widths[-1] != N_ACTIONS:
            raise InputError(f"Expected a network of {N_FEATURES} inputs and {N_ACTIONS} outputs, got {shapes}")
        self._network = as_network(layers)

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
            deterministic: ignored; the actions are always the most probable ones.

        Returns:
            Acceleration and steering, shape (B, 2), each in [-1, 1], and the state for the next call.

        Raises:
            InputError: if an array has the wrong shape.
        """
        scenes = as_scenes(observation)
        memory = as_memory(state, episode_start, (len(scenes), N_MEMORIES))
        actions = decide_batch(self._network, see_batch(self._course, scenes, memory))
        return track_batch(self._course, scenes, actions, memory), memory

    def draw(
        self, observation: Floats, state: Floats | None, episode_start: NDArray[np.bool_] | None, noise: Floats
    ) -> tuple[Floats, Floats]:
        """Draw the actions of a batch of egos; see `behavexplor.ads.interface.StochasticADS`."""
        scenes = as_scenes(observation)
        memory = as_memory(state, episode_start, (len(scenes), N_MEMORIES))
        actions = draw_batch(self._network, see_batch(self._course, scenes, memory), noise[:, 0])
        return track_batch(self._course, scenes, actions, memory), memory

    def log(self, state: Floats) -> Mapping[str, Floats]:
        """Return the offset of the ego's wanted lane from the route [m], shape (B,)."""
        return {"wanted_offset": state[:, WANTED]}


def see_batch(course: Course, scenes: Floats, memory: Floats) -> Floats:
    """Compute the features that policies see, shape (B, N_FEATURES).

    Args:
        course: route table, see `behavexplor.ads.learned.route_table`.
        scenes: scenes, shape (B, 1 + n, 8), see `behavexplor.data.scene`.
        memory: memory of each ego, shape (B, 3). A row of zeros begins an episode; it is changed in place.
    """
    seen = np.zeros((len(scenes), N_FEATURES))
    _see_all(course, scenes, memory, seen)
    return seen


def track_batch(course: Course, scenes: Floats, actions: NDArray[np.int64], memory: Floats) -> Floats:
    """Compute the commands for policies' actions, shape (B, 2), each in [-1, 1] over its range.

    Args:
        course: route table, see `behavexplor.ads.learned.route_table`.
        scenes: scenes, shape (B, 1 + n, 8), see `behavexplor.data.scene`.
        actions: indices of the actions, shape (B,).
        memory: memory of each ego, shape (B, 3), changed in place.
    """
    commands = np.zeros((len(scenes), 2))
    _track_all(course, scenes, actions, memory, commands)
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
def _track_all(course: Course, scenes: Floats, actions: NDArray[np.int64], memory: Floats, commands: Floats) -> None:
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] != 0.0:
            commands[i, 0], commands[i, 1] = track(course, scenes[i], actions[i], memory[i])


def read_layers(path: Path) -> list[tuple[Floats, Floats]]:
    """Read weights and biases from a file of `write_layers`.

    Raises:
        InputError: if the file cannot be read.
    """
    try:
        file = read_arrays(path.read_bytes())
        layers = [(file[f"weights_{i}"], file[f"bias_{i}"]) for i in range(len(file) // 2)]
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path} contains no network of this package: {error}") from None
    if any(array.dtype.kind != "f" for layer in layers for array in layer):
        raise InputError(f"{path} contains no network of this package: weights and biases must be floats")
    if any((weights.ndim, bias.ndim) != (2, 1) for weights, bias in layers):
        raise InputError(f"{path} contains no network of this package: weights must be matrices, and biases vectors")
    return [(weights.astype(np.float64), bias.astype(np.float64)) for weights, bias in layers]


def write_layers(path: Path, layers: list[tuple[Floats, Floats]]) -> None:
    """Write weights and biases as float32 arrays."""
    arrays = {f"weights_{i}": weights.astype(np.float32) for i, (weights, _) in enumerate(layers)}
    arrays |= {f"bias_{i}": bias.astype(np.float32) for i, (_, bias) in enumerate(layers)}
    np.savez_compressed(path, allow_pickle=False, **arrays)
