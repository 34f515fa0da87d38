"""The networks in a file of weights, as far as the names and shapes of their layers tell."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Final, Literal

import numpy as np

from behavexplor.ads.weights.tensors import TensorFile
from behavexplor.data.array_types import Array

MOST_LAYERS: Final = 100  # of one network
Output = Literal["values", "logits", "mean"]
DENSE, CONVOLUTION = "dense", "convolutional"
TARGET, DEVIATION, VALUE, ADVANTAGE, ACTION = "target", "deviation", "value", "advantage", "action"
_ROLES: Final[Mapping[str, re.Pattern[str]]] = MappingProxyType(  # the first one that is found in a name counts
    {
        TARGET: re.compile(r"target|tgt|(^|[._])old([._]|$)"),
        DEVIATION: re.compile(r"log_?(std|sigma|var)|(^|[._])(std|sigma)"),
        ADVANTAGE: re.compile(r"advantage|(^|[._])(adv|a)([._\d]|$)|_(adv|a)([._]|$)"),
        VALUE: re.compile(r"critic|(?<!q)(?<!q_)(?<!action_)value(?!s)|(^|[._])vf?([._\d]|$)|_vf?([._]|$)"),
        ACTION: re.compile(
            r"actor|policy|logits|action|mean|(^|[._])(pi|mu|q\d?|probs)([._]|$)|_(pi|mu|q)([._]|$)|q_?(values?|net)"
        ),
    }
)
_FIRST_CHOICE: Final = re.compile(r"actor|policy|(^|[._])pi([._]|$)|online|local|eval|main")
_OTHER_KINDS: Final[Mapping[str, re.Pattern[str]]] = MappingProxyType(
    {
        "recurrent": re.compile(r"weight_(ih|hh)(_l\d+)?$"),
        "attention": re.compile(r"in_proj_weight$|attention.*weight$|(key|query)_\w+\.weight$"),
        "noisy": re.compile(r"weight_(mu|sigma)$"),
        "reparametrized": re.compile(r"weight_(orig|g|v)$|parametrizations\.weight\."),
        "normalizing": re.compile(r"running_(mean|var)$"),
    }
)
_OTHER_GRIDS: Final = "one- or three-dimensional convolutional"
_OF_DIMENSIONS: Final[Mapping[int, str]] = MappingProxyType(
    {1: "normalizing", 2: DENSE, 3: _OTHER_GRIDS, 4: CONVOLUTION, 5: _OTHER_GRIDS}
)


@dataclass(frozen=True)
class Layer:
    """A layer with weights."""

    name: str  # its name in the file
    kind: str  # `DENSE`, `CONVOLUTION`, or a kind that is not supported, such as "recurrent"
    weight: Array  # its weights, shape (outputs, inputs), or (outputs, inputs, rows, columns) of a convolution
    bias: Array | None  # its biases, shape (outputs,); None without

    @property
    def outputs(self) -> int:
        """Number of its outputs, or channels."""
        return int(self.weight.shape[0])

    @property
    def inputs(self) -> int:
        """Number of its inputs, or channels."""
        return int(self.weight.shape[1])


@dataclass(frozen=True)
class ActingNetwork:
    """A network that leads from observations to actions."""

    name: str  # its place in the file, such as "q_net"; empty for all of the file
    trunk: tuple[Layer, ...]  # layers that its heads share
    head: tuple[Layer, ...]  # layers from there to the actions
    value: tuple[Layer, ...] = ()  # layers from there to the value of a dueling network; none in any other one
    deviation: tuple[Layer, ...] = ()  # layers from there to the logarithms of standard deviations; none without
    log_std: Array | None = None  # logarithms of standard deviations that no observation changes; None without
    output: Output | None = None  # what its last layer gives, as far as names tell; None if unknown

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The layers that lead to the actions."""
        return (*self.trunk, *self.head)

    @property
    def convolutions(self) -> tuple[Layer, ...]:
        """The convolutional ones among these layers, which come first."""
        return tuple(layer for layer in self.layers if layer.kind == CONVOLUTION)

    @property
    def n_weights(self) -> int:
        """Number of weights in the layers to the actions and the value, without biases."""
        return int(sum(np.prod(one.weight.shape) for one in (*self.layers, *self.value)))

    @property
    def is_finite(self) -> bool:
        """Whether its weights are finite numbers of the type float32, by which it decides."""
        layers = (*self.layers, *self.value, *self.deviation)
        arrays = [self.log_std, *(array for layer in layers for array in (layer.weight, layer.bias))]
        with np.errstate(over="ignore"):  # a greater number becomes infinite
            return all(np.isfinite(array.astype(np.float32)).all() for array in arrays if array is not None)

    def __str__(self) -> str:
        """Return the numbers of inputs and outputs, such as "25-256-256-5", for messages."""
        dense = _widths([one for one in self.layers if one.kind == DENSE])
        grids = f"conv {_widths(self.convolutions)}, dense " if self.convolutions else ""
        return f"{grids}{dense}{' with a value' if self.value else ''}"


def networks_in(file: TensorFile) -> list[ActingNetwork]:
    """Return the networks in a file that can lead to actions, without targets; none if such a layer is unsupported."""
    names = list(file.arrays) if file.in_order else sorted(file.arrays, key=_natural)
    layers = [layer for name in names if (layer := _layer(name, file.arrays)) is not None]
    online = [layer for layer in layers if _role(layer.name) != TARGET] or layers
    stored = {name: array for name, array in file.arrays.items() if re.search(r"log_?std$", name.lower())}
    acting = [layer for layer in online if _role(layer.name) != VALUE]
    if len(online) > 10 * MOST_LAYERS or any(layer.kind not in (DENSE, CONVOLUTION) for layer in acting):
        return []
    return _networks(online, stored)


def chosen(networks: Sequence[ActingNetwork], name: str | None) -> ActingNetwork | None:
    """Return the network of a name, or the only one that acts; None if it is not clear which one that is."""
    if name is not None:
        return next((one for one in networks if one.name == name), None)
    first = [one for one in networks if _FIRST_CHOICE.search(one.name.lower())]
    for few in (networks, first):
        if len(few) == 1:
            return few[0]
    return None


def reason_against(file: TensorFile) -> str:
    """Return why a file without a network that is supported has none, in words that continue "it has"."""
    names = list(file.arrays)
    for kind, pattern in _OTHER_KINDS.items():
        if any(pattern.search(name) for name in names):
            return f"{kind} layers"
    layers = [layer for name in names if (layer := _layer(name, file.arrays)) is not None]
    odd = next((layer.kind for layer in layers if layer.kind not in (DENSE, CONVOLUTION)), None)
    if odd is not None:
        return f"{odd} layers"
    shapes = ", ".join(f"{one.name} {one.inputs}-{one.outputs}" for one in layers[:6])
    return f"layers that do not follow one another ({shapes})" if layers else "no floats with a name such as fc1.weight"


def unused(file: TensorFile, network: ActingNetwork) -> list[str]:
    """Return the names of vectors that no layer uses, and that have a number for each input of a network."""
    inputs = network.layers[0].inputs
    rest = [name for name, array in file.arrays.items() if array.shape in ((inputs,), (1, inputs)) and inputs > 1]
    return [name for name in rest if not re.search(r"(weight|bias)$|optim|log_?std", name.lower())]


def _layer(name: str, arrays: Mapping[str, Array]) -> Layer | None:
    """Return the layer to which an array belongs as its weights; None for any other array."""
    array = arrays[name]
    other = next((kind for kind, pattern in _OTHER_KINDS.items() if pattern.search(name)), None)
    stem = name.removesuffix("weight").rstrip(".")
    if other is None and (not name.endswith("weight") or array.dtype.kind != "f"):
        return None
    kind = other or _OF_DIMENSIONS.get(array.ndim, f"{array.ndim}-dimensional")
    bias = arrays.get(f"{name.removesuffix('weight')}bias")
    if kind in (DENSE, CONVOLUTION) and bias is not None and bias.shape != array.shape[:1]:
        kind = "unmatched"
    return Layer(stem, kind, array if array.ndim > 1 else array.reshape(-1, 1), bias)


def _networks(layers: Sequence[Layer], stored: Mapping[str, Array]) -> list[ActingNetwork]:
    """Return the networks that some layers form: one, if they follow one another, or those of their parts."""
    prefix = _common(layers)
    whole = _network(prefix, layers, stored)
    if whole is not None or len(layers) < 2:
        return [whole] if whole is not None else []
    parts: dict[str, list[Layer]] = {}
    for layer in layers:
        parts.setdefault(layer.name[len(prefix) :].lstrip(".").partition(".")[0], []).append(layer)
    if len(parts) in (1, len(layers)):
        return []
    return [found for part in parts.values() for found in _networks(part, stored)]


def _network(prefix: str, layers: Sequence[Layer], stored: Mapping[str, Array]) -> ActingNetwork | None:
    """Return the network of layers that form one; None if they do not."""
    roles = [_role(layer.name[len(prefix) :].lstrip(".")) for layer in layers]
    of: dict[str | None, list[Layer]] = {}
    for layer, role in zip(layers, roles, strict=True):  # without a value, "a" is just a name
        of.setdefault(None if role == ADVANTAGE and VALUE not in roles else role, []).append(layer)
    plain, action, value = (of.get(role, []) for role in (None, ACTION, VALUE))
    deviation, advantage = of.get(DEVIATION, []), of.get(ADVANTAGE, [])
    output: Output | None = None
    if advantage:
        if value[-1].outputs != 1:
            return None
        trunk, head = [*plain, *action], advantage
        output = "values"
    else:
        has_critic = bool(value) and value[-1].outputs == 1
        heads = action or (value if not has_critic else [])
        trunk, head = (plain, heads) if heads else ([], plain)
        output = "logits" if has_critic and action else None
        value = []
    shared = [*trunk, *head[:-1]]
    log_std = next((array for name, array in stored.items() if name.startswith(prefix)), None)
    if deviation or log_std is not None:
        trunk, head, output = shared, head[-1:], "mean"
    branches = [(*trunk, *branch) for branch in (head, value, deviation) if branch]
    if not head or not all(map(_is_chain, branches)):
        return None
    return ActingNetwork(prefix.rstrip("."), tuple(trunk), tuple(head), tuple(value), tuple(deviation), log_std, output)


def _is_chain(layers: Sequence[Layer]) -> bool:
    """Return whether layers can follow one another."""
    known = all(one.kind in (DENSE, CONVOLUTION) and one.weight.size for one in layers) and layers[-1].kind == DENSE
    return known and len(layers) <= MOST_LAYERS and all(_follows(*pair) for pair in pairwise(layers))


def _follows(before: Layer, after: Layer) -> bool:
    if before.kind == CONVOLUTION and after.kind == DENSE:  # the channels of each place of the grid
        return after.inputs % max(before.outputs, 1) == 0 and after.inputs > 0
    return before.kind == after.kind and before.outputs == after.inputs


def _widths(layers: Sequence[Layer]) -> str:
    return "-".join(map(str, [one.inputs for one in layers] + [one.outputs for one in layers[-1:]]))


def _role(name: str) -> str | None:
    """Return what a layer is for, by its name; None for a layer that may be for anything."""
    return next((role for role, pattern in _ROLES.items() if pattern.search(name.lower())), None)


def _common(layers: Iterable[Layer]) -> str:
    """Return the beginning that the names of layers share, up to and with a dot."""
    split = [layer.name.split(".")[:-1] for layer in layers]
    shared = []
    for parts in zip(*split, strict=False):
        if len(set(parts)) > 1:
            break
        shared.append(parts[0])
    return "".join(f"{part}." for part in shared)


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Return a key by which fc2 comes before fc10."""
    return [(int(part.isdecimal()), int(part) if part.isdecimal() else 0, part) for part in re.split(r"(\d+)", name)]
