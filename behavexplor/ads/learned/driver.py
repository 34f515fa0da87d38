"""A learned policy as a driving system under test, with the weights of its network as plain arrays.

The network is evaluated here, too: its sums run in a fixed order, so that no last bit depends on the batch.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from behavexplor.ads.learned import deciding
from behavexplor.ads.learned.network_file import TrainedNetwork
from behavexplor.ads.learned.observation import N_FEATURES, see
from behavexplor.ads.learned.route_table import Course, make_course
from behavexplor.ads.scene_io import ACTION, OBSERVATION, as_memory, as_scenes, fill_action
from behavexplor.data.array_types import Bools, Floats, Ints
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scene import EGO, N_COLUMNS, PRESENT
from behavexplor.errors import InputError
from behavexplor.jit import compiled_for, kernel_in_place, kernel_inner

_CACHE_LINE: Final = 64  # bytes
POLICY_FREQUENCY: Final = round(1 / deciding.PERIOD)


class LearnedDriver:
    """A driver whose network sees conflicts and gaps and chooses an acceleration and a lane, which a tracker follows.

    Args:
        roadmap: road map with the ego's route.
        network: network whose outputs are the preferences of the actions. Between two layers tanh is applied.

    Raises:
        InputError: if the layers do not fit each other, or the numbers of features and actions.
    """

    observation: Mapping[str, Any] = OBSERVATION  # `{"type": "Scene"}`, see `behavexplor.data.scene`
    action: Mapping[str, Any] = ACTION  # acceleration and steering, each in [-1, 1] over its range
    policy_frequency: int = POLICY_FREQUENCY  # decisions per second, 5 Hz
    vectorized: bool = True  # each row is decided independently
    noise: int = 1  # see `behavexplor.ads.interface.StochasticADS`

    def __init__(self, roadmap: RoadMap, network: TrainedNetwork) -> None:
        self._course = make_course(roadmap)
        widths = [N_FEATURES, *(len(bias) for _, bias in network.layers)]
        shapes = [(weights.shape, bias.shape) for weights, bias in network.layers]
        expected = [((after, before), (after,)) for before, after in pairwise(widths)]
        if shapes != expected or widths[-1] != deciding.N_ACTIONS:
            raise InputError(
                f"Expected a network of {N_FEATURES} inputs and {deciding.N_ACTIONS} outputs, got {shapes}"
            )
        self._network = as_network(network.layers)
        self._rule = deciding.MEAN if network.rule == "mean" else deciding.MOST_PROBABLE
        self._widest = max(widths)
        # arguments of the smallest shapes, for whose types the kernel is compiled
        scenes = np.zeros((1, 1, N_COLUMNS))
        memory = np.zeros((1, deciding.N_MEMORIES))
        rooms = np.empty((2, 1, self._widest))  # for the values of layers, see `evaluate`
        rows = np.empty(1, dtype=np.int64)
        shares = np.zeros(1)
        actions = np.zeros((1, 2))
        tables = (self._course, self._network, deciding.ACCELERATION_TABLE)
        self._drive_all: Any = compiled_for(
            _drive_all, *tables, scenes, memory, self._rule, shares, rooms, rows, actions
        )

    def predict(
        self,
        observation: Floats,
        state: Floats | None = None,
        episode_start: Bools | None = None,
        deterministic: bool = True,  # noqa: ARG002 - `draw` draws
    ) -> tuple[Floats, Floats]:
        """Decide for a batch of egos; see `behavexplor.ads.interface.ADS`.

        Args:
            observation: scenes, shape (B, 1 + n, 8), see `behavexplor.data.scene`.
            state: state returned by the last call, shape (B, 3); None in the first call.
            episode_start: True for each row that begins an episode, shape (B,); None if no row does.
            deterministic: without effect. This method never samples an action.

        Returns:
            Acceleration and steering, shape (B, 2), each in [-1, 1], and the state for the next call.

        Raises:
            InputError: if an array has the wrong shape.
        """
        return self._drive(observation, state, episode_start, None)

    def draw(
        self, observation: Floats, state: Floats | None, episode_start: Bools | None, noise: Floats
    ) -> tuple[Floats, Floats]:
        """Draw the actions of a batch of egos; see `behavexplor.ads.interface.StochasticADS`."""
        return self._drive(observation, state, episode_start, np.array(noise[:, 0], dtype=np.float64))

    def log(self, state: Floats) -> Mapping[str, Floats]:
        """Return the offset of the ego's wanted lane from the route [m], shape (B,)."""
        return {"wanted_offset": state[:, deciding.WANTED]}

    def _drive(
        self, observation: Floats, state: Floats | None, episode_start: Bools | None, shares: Floats | None
    ) -> tuple[Floats, Floats]:
        """Return the actions, shape (B, 2), and the memory. The action of an absent ego is 0.

        The actions are drawn by `shares`, numbers in [0, 1), shape (B,); None for the network's own rule.
        """
        scenes = as_scenes(observation)
        memory = as_memory(state, episode_start, (len(scenes), deciding.N_MEMORIES))
        rule = deciding.DRAWN
        if shares is None:
            rule, shares = self._rule, np.zeros(len(scenes))
        rooms = np.empty((2, len(scenes), self._widest))
        rows = np.empty(len(scenes), dtype=np.int64)
        actions = np.zeros((len(scenes), 2))
        tables = (self._course, self._network, deciding.ACCELERATION_TABLE)
        self._drive_all(*tables, scenes, memory, rule, shares, rooms, rows, actions)
        return actions, memory


class CourseKernels:
    """What policies see of a batch of scenes, and the commands for their decisions, computed by machine code."""

    def __init__(self, course: Course) -> None:
        self._course = course
        # arguments of the smallest shapes, for whose types the kernels are compiled
        scenes = np.zeros((1, 1, N_COLUMNS))
        memory = np.zeros((1, deciding.N_MEMORIES))
        seen = np.zeros((1, N_FEATURES))
        decisions = deciding.Decisions(np.zeros(1), np.zeros(1, dtype=np.int64))
        self._see_all = compiled_for(_see_all, course, scenes, memory, seen)
        self._track_all = compiled_for(_track_all, course, scenes, decisions, memory, np.zeros((1, 2)))

    def see(self, scenes: Floats, memory: Floats) -> Floats:
        """Compute the features that policies see, shape (B, N_FEATURES).

        `scenes`, shape (B, 1 + n, 8), see `behavexplor.data.scene`, and `memory`, shape (B, 3), must be contiguous. A
        row of zeros in the memory begins an episode. The memory is changed in place.
        """
        seen = np.zeros((len(scenes), N_FEATURES))
        self._see_all(self._course, scenes, memory, seen)
        return seen

    def track(self, scenes: Floats, decisions: deciding.Decisions, memory: Floats) -> Floats:
        """Compute the commands for policies' decisions, shape (B, 2), each in [-1, 1] over its range.

        For `scenes` and `memory`, see `see`. The memory is changed in place.
        """
        actions = np.zeros((len(scenes), 2))
        self._track_all(self._course, scenes, decisions, memory, actions)
        return actions


class DenseNetwork(NamedTuple):
    """The numbers of all layers in flat arrays, for any number of layers."""

    # weights of all layers, shape (weights,). In a layer, the weights from the first input to each output come first,
    # then those from the second input.
    weights: Floats
    biases: Floats  # biases of all layers, shape (outputs of all layers,)
    widths: Ints  # number of inputs, and number of outputs of each layer, shape (layers + 1,)


def as_network(layers: Sequence[tuple[Floats, Floats]]) -> DenseNetwork:
    """Make a network from the weights, shape (outputs, inputs), and biases, shape (outputs,), of each layer."""
    widths = [layers[0][0].shape[1], *(len(bias) for _, bias in layers)]
    return DenseNetwork(
        weights=_aligned(np.concatenate([weights.T.ravel() for weights, _ in layers], dtype=np.float64)),
        biases=np.concatenate([bias for _, bias in layers], dtype=np.float64),
        widths=np.array(widths, dtype=np.int64),
    )


def _aligned(values: Floats) -> Floats:
    """Return a copy that begins where a cache line begins."""
    # Vectors that lie in two cache lines take longer to read: up to a tenth of the evaluation of a network.
    room = np.empty(len(values) + _CACHE_LINE // values.itemsize)
    skipped = (-room.ctypes.data % _CACHE_LINE) // values.itemsize  # values before the next cache line
    copy = room[skipped : skipped + len(values)]
    copy[:] = values
    return copy


@kernel_in_place
def _drive_all(  # noqa: PLR0913, PLR0917 - a tuple of them would be copied in each call
    course: Course,
    network: DenseNetwork,
    accelerations: Floats,
    scenes: Floats,
    memory: Floats,
    rule: int,
    shares: Floats,
    rooms: Floats,
    rows: Ints,
    actions: Floats,
) -> None:
    """Fill in the actions of the egos that are present, shape (B, 2), each in [-1, 1].

    `rooms`, see `evaluate`, and `rows`, shape (B,), are for intermediate results.
    """
    count = 0
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] != 0.0:
            _see(course, scenes[i], memory[i], rooms[0, i, :N_FEATURES])
            rows[count] = i
            count += 1
    outputs = evaluate(network, rooms, rows[:count])
    for i in rows[:count]:
        wanted, lane = deciding.choose(rooms[outputs, i, : deciding.N_ACTIONS], accelerations, rule, shares[i])
        _track(course, scenes[i], wanted, lane, memory[i], actions[i])


@kernel_in_place
def _see_all(course: Course, scenes: Floats, memory: Floats, seen: Floats) -> None:
    """Fill in what the egos that are present see, shape (B, N_FEATURES)."""
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] != 0.0:
            _see(course, scenes[i], memory[i], seen[i])


@kernel_in_place
def _track_all(course: Course, scenes: Floats, decisions: deciding.Decisions, memory: Floats, actions: Floats) -> None:
    """Fill in the actions for policies' decisions, shape (B, 2), each in [-1, 1], of the egos that are present."""
    for i in range(len(scenes)):
        if scenes[i, EGO, PRESENT] != 0.0:
            _track(course, scenes[i], decisions.accelerations[i], decisions.lanes[i], memory[i], actions[i])


@kernel_inner
def _see(course: Course, scene: Floats, memory: Floats, seen: Floats) -> None:
    """Fill in what an ego sees. If its memory is one of zeros, begin it first."""
    if memory[deciding.STARTED] == 0.0:
        deciding.begin(course, scene, memory)
    see(course, scene, memory[deciding.WANTED], seen)


@kernel_inner
def _track(course: Course, scene: Floats, wanted: float, lane: int, memory: Floats, action: Floats) -> None:
    """Fill in an ego's action for its wanted acceleration [m/s2] and its lane choice."""
    acceleration, steering = deciding.track(course, scene, wanted, lane, memory)
    fill_action(acceleration, steering, action)


@kernel_inner
def evaluate(network: DenseNetwork, rooms: Floats, rows: Ints) -> int:
    """Compute the outputs of a network for some rows, shape (n,), and return the index of the outputs in `rooms`.

    The sums run over the inputs in their order, so that no row's last bits depend on the batch or on a library.

    `rooms`, shape (2, B, greatest width), holds the inputs in `rooms[0]`, and is changed in place. Each layer reads one
    room and writes the other one.
    """
    weight_at, bias_at, now = 0, 0, 0  # where the layer begins in weights and biases, and which room has its inputs
    for layer in range(len(network.widths) - 1):
        before, width = network.widths[layer], network.widths[layer + 1]
        for row in rows:
            if layer > 0:
                _squash(rooms[now, row], before)
            for j in range(width):
                rooms[1 - now, row, j] = network.biases[bias_at + j]
        weights = network.weights[weight_at : weight_at + before * width]
        _add_up(weights, rooms[now], before, rooms[1 - now], width, rows)
        weight_at, bias_at, now = weight_at + before * width, bias_at + width, 1 - now
    return now


@kernel_inner
def _squash(values: Floats, count: int) -> None:
    """Apply tanh to the first values of a row, in place."""
    for i in range(count):
        values[i] = math.tanh(values[i])


@kernel_inner
def _add_up(weights: Floats, values: Floats, inputs: int, sums: Floats, width: int, rows: Ints) -> None:
    """Add the products of the inputs `values` and the weights to the sums of each row's outputs.

    Each weight is used for all rows before the next ones are read from memory, and eight inputs are added at a time.
    """
    whole = inputs - inputs % 8
    for i in range(0, whole, 8):
        block = weights[i * width : (i + 8) * width].reshape((8, width))
        for row in rows:
            _add_eight(block, values[row, i : i + 8], sums[row, :width])
    for i in range(whole, inputs):
        rest = weights[i * width : (i + 1) * width]
        for row in rows:
            into, value = sums[row, :width], values[row, i]
            for j in range(len(into)):
                into[j] += rest[j] * value


@kernel_inner
def _add_eight(block: Floats, x: Floats, into: Floats) -> None:
    """Add the products of eight inputs `x` and their weights, shape (8, outputs), to a row's sums."""
    a, b, c, d, e, f, g, h = block[0], block[1], block[2], block[3], block[4], block[5], block[6], block[7]
    p, q, r, s, t, u, v, w = x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7]
    for j in range(len(into)):  # one input after the other: the last bits do not depend on how many are added at a time
        first = into[j] + a[j] * p + b[j] * q + c[j] * r + d[j] * s
        into[j] = first + e[j] * t + f[j] * u + g[j] * v + h[j] * w
