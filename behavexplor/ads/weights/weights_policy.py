"""A policy whose file holds weights alone: its layers come from the file, what the file cannot say from the user."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np
import torch

from behavexplor.ads.learned.network_file import DIVERGED
from behavexplor.ads.sb3.description import ENVIRONMENT_KEYS, Description, describe
from behavexplor.ads.sb3.layered import LayeredPolicy, Parts
from behavexplor.ads.sb3.normalization import Statistics
from behavexplor.ads.sb3.policy import SB3Policy
from behavexplor.ads.weights.layers import (
    CONVOLUTION,
    DENSE,
    ActingNetwork,
    Layer,
    chosen,
    networks_in,
    reason_against,
    unused,
)
from behavexplor.ads.weights.tensors import TensorFile, read_tensors
from behavexplor.data.target import Activation
from behavexplor.errors import InputError, sentence

_LOG: Final = logging.getLogger(__name__)
_FUNCTIONS: Final[Mapping[Activation, type[torch.nn.Module]]] = {
    "relu": torch.nn.ReLU,
    "tanh": torch.nn.Tanh,
    "elu": torch.nn.ELU,
    "gelu": torch.nn.GELU,
    "silu": torch.nn.SiLU,
    "leaky_relu": torch.nn.LeakyReLU,
    "sigmoid": torch.nn.Sigmoid,
    "identity": torch.nn.Identity,
}


class WeightsPolicy:
    """A network of a file, which becomes a policy in an environment: only there are its observations and actions known.

    The observation and action configuration and the frequencies are attributes only where they are known, and so is
    `env_config`.
    """

    def __init__(self, path: Path, network: ActingNetwork, description: Description) -> None:
        self.path, self.network, self.description = path, network, description
        for name in ENVIRONMENT_KEYS:
            if (value := getattr(description, name)) is not None:
                setattr(self, name, value)
        if description.config is not None:
            self.env_config = dict(description.config)

    def seeing(self, space: gymnasium.Space[Any], action_space: gymnasium.Space[Any]) -> SB3Policy:
        """Return the policy for the observations and actions of an environment.

        Where they do not fit the network, the policy has other spaces, as far as the network tells them.

        Raises:
            InputError: if a setting is missing, or its convolutions do not fit the observations.
        """
        outputs, described = self.network.head[-1].outputs, self.description
        commands: gymnasium.Space[Any] = gymnasium.spaces.Discrete(outputs)
        is_box = isinstance(action_space, gymnasium.spaces.Box) and action_space.shape == (outputs,)
        if is_box or (described.output or self.network.output) == "mean":
            commands = action_space if is_box else gymnasium.spaces.Box(-1.0, 1.0, (outputs,))
        if is_box and described.squash is None and self.network.log_std is None:
            raise _lacking(self.path, self.network, ["`squash: true` if tanh follows its last layer, or else `false`"])
        squash = bool(described.squash) and is_box
        seen = self._space(space)
        policy = LayeredPolicy(seen, commands, _parts(self.network, described), squash=squash)
        statistics = Statistics.read(described.statistics) if described.statistics else None
        return SB3Policy(policy, described, statistics, None).seeing(space, action_space)

    def _space(self, space: gymnasium.Space[Any]) -> gymnasium.spaces.Box:
        """Return the space of the observations of the network."""
        if not self.network.convolutions:
            return _numbers((self.network.layers[0].inputs,))
        shape, channels = space.shape or (), self.network.layers[0].inputs
        needed = next(one for one in self.network.layers if one.kind == DENSE)
        if len(shape) != 3 or shape[0] != channels or space.dtype is None or space.dtype.kind != "f":
            raise InputError(
                f"{self.path} has convolutions ({self.network}) for grids with {channels} channels of floats, but the "
                f"observations of the environment have the shape {shape}: give the observation of its training, such "
                f"as `observation: {{type: OccupancyGrid}}`, in {self.path.with_suffix('.yaml').name} beside it"
            )
        grid = tuple(shape[1:])
        for layer, stride, padding in _steps(self.network, self.description):
            kernel = layer.weight.shape[2:]
            grid = tuple((n + 2 * padding - k) // stride + 1 for n, k in zip(grid, kernel, strict=True))
        made = (self.network.convolutions[-1].outputs, *grid)
        if prod(made) != needed.inputs or min(grid) < 1:
            raise InputError(
                f"The convolutions of {self.path} make {made} of observations of the shape {shape}, but its next layer "
                f"takes {needed.inputs} numbers: correct `strides`, `paddings` or `observation` in "
                f"{self.path.with_suffix('.yaml').name}"
            )
        return _numbers((channels, *shape[1:]))


def load_weights(path: Path, activation: Activation | None = None) -> WeightsPolicy:
    """Read a policy from a file of weights. No code of the file is executed.

    Raises:
        InputError: if it has no network that can drive, or a setting is missing.
    """
    file = read_tensors(path)
    for suspicion in file.suspicions:
        _LOG.warning("%s", sentence(f"{path}: {suspicion}"))
    described = describe(path)
    description = replace(described, activation=activation or described.activation)
    network = network_of(file, description)
    if lacking := missing_settings(network, description):
        raise _lacking(path, network, lacking)
    if not network.is_finite:
        raise InputError(f"{path} {DIVERGED}")
    if rest := unused(file, network):
        _LOG.warning(
            f"{path} also has {', '.join(rest[:4])}, which no layer uses: if its script changes observations by them, "
            "name a wrapper that does so (docs/policies.md)"
        )
    return WeightsPolicy(path, network, description)


def network_of(file: TensorFile, description: Description) -> ActingNetwork:
    """Return the network of a file that acts.

    Raises:
        InputError: if there is none, or it is not clear which one it is.
    """
    networks = networks_in(file)
    if not networks:
        raise InputError(
            f"{file.path} has {reason_against(file)}, and only dense and convolutional networks can be read: write a "
            "driver that makes its network, and name it as module:attribute (docs/policies.md)"
        )
    network = chosen(networks, description.network)
    if network is None:
        listed = ", ".join(f"{one.name or 'its layers'} ({one})" for one in networks[:8])
        raise InputError(
            f"{file.path} has the networks {listed}: name the one that acts as `network: {networks[0].name}` in "
            f"{file.path.with_suffix('.yaml').name} beside it"
        )
    if network.n_weights > file.size:
        raise InputError(f"{file.path} has fewer bytes than its network has weights; it was not loaded")
    return network


def missing_settings(network: ActingNetwork, description: Description) -> list[str]:
    """Return the settings that a network needs and its description lacks, each as a phrase that shows it."""
    missing = []
    if len(network.layers) > 1 and description.activation is None:
        missing.append("`activation: relu` (or tanh, or another function; or --activation relu)")
    count = len(network.convolutions)
    if count and (description.strides is None or len(description.strides) != count):
        missing.append(f"`strides: {[1] * count}`")
    if count and description.paddings is not None and len(description.paddings) != count:
        missing.append(f"`paddings: {[0] * count}`")
    return missing


def _lacking(path: Path, network: ActingNetwork, settings: Sequence[str]) -> InputError:
    where = path.with_suffix(".yaml").name
    return InputError(
        f"{path} has the layers {network}, but no file says everything about them: add {' and '.join(settings)} to "
        f"{where} beside it"
    )


def _steps(network: ActingNetwork, description: Description) -> Iterator[tuple[Layer, int, int]]:
    """Return the convolutions, each with its stride and padding."""
    count = len(network.convolutions)
    strides, paddings = description.strides or [1] * count, description.paddings or [0] * count
    return zip(network.convolutions, strides, paddings, strict=True)


def _parts(network: ActingNetwork, description: Description) -> Parts:
    """Return the layers of a network as those of torch, with the function between any two of them."""
    function = _FUNCTIONS[description.activation or "identity"]
    made = {layer.name: _module(layer, stride, padding) for layer, stride, padding in _steps(network, description)}
    made |= {layer.name: _module(layer) for layer in (*network.layers, *network.value) if layer.name not in made}

    def line(layers: Sequence[Layer], *, ends: bool) -> torch.nn.Sequential:
        listed: list[torch.nn.Module] = []
        for layer in layers:
            if network.convolutions and layer.kind == DENSE:
                listed.append(torch.nn.Flatten())  # which changes nothing but the output of a convolution
            listed += [made[layer.name], function()]
        return torch.nn.Sequential(*(listed[:-1] if ends else listed))

    is_logits = (description.output or network.output) == "logits"
    log_std = None if network.log_std is None else torch.tensor(np.array(network.log_std, np.float32).ravel())
    head = line(network.head, ends=True)
    value = line(network.value, ends=True) if network.value else None
    return Parts(line(network.trunk, ends=False), head, value, log_std, is_logits)


def _module(layer: Layer, stride: int = 1, padding: int = 0) -> torch.nn.Module:
    with_bias, weight = layer.bias is not None, torch.tensor(np.ascontiguousarray(layer.weight, np.float32))
    made: torch.nn.Linear | torch.nn.Conv2d
    if layer.kind == CONVOLUTION:
        kernel = (int(weight.shape[2]), int(weight.shape[3]))
        made = torch.nn.Conv2d(layer.inputs, layer.outputs, kernel, stride, padding, bias=with_bias, device="meta")
    else:
        made = torch.nn.Linear(layer.inputs, layer.outputs, bias=with_bias, device="meta")
    made.weight = torch.nn.Parameter(weight, requires_grad=False)
    if layer.bias is not None:
        made.bias = torch.nn.Parameter(torch.tensor(np.array(layer.bias, np.float32)), requires_grad=False)
    return made


def _numbers(shape: tuple[int, ...]) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
