"""The file of a trained policy: the weights of its network as plain arrays, and how it decides."""

from pathlib import Path
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.durable import new_file
from behavexplor.data.untrusted import read_arrays, read_file
from behavexplor.errors import InputError

Rule = Literal["mean", "most probable"]  # how a policy decides when it does not draw
RULES: Final[tuple[Rule, ...]] = get_args(Rule)
DIVERGED: Final = "has weights that are NaN or infinite, as after a training that diverged: give an earlier one"

Layers = list[tuple[Floats, Floats]]

_RULE: Final = "decision"  # name of the rule in a file


class TrainedNetwork(NamedTuple):
    """A network and how its policy decides."""

    layers: Layers  # weights, shape (outputs, inputs), and biases, shape (outputs,), of each layer
    rule: Rule = "mean"  # how the policy decides when it does not draw, see `behavexplor.ads.learned.deciding.choose`


def read_network(path: Path) -> TrainedNetwork:
    """Read a network from a file of `write_network`.

    Raises:
        InputError: if the file cannot be read.
    """
    try:
        file = dict(read_arrays(read_file(path)))
        rule = str(file.pop(_RULE))
        layers = [(file[f"weights_{i}"], file[f"bias_{i}"]) for i in range(len(file) // 2)]
    except FileNotFoundError:
        raise InputError(f"There is no file {path}") from None
    except InputError:
        raise
    except KeyError as error:
        raise InputError(f"{path} contains no network of this package: it has no array {error}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path} contains no network of this package: {error}") from None
    if any(array.dtype.kind != "f" for layer in layers for array in layer):
        raise InputError(f"{path} contains no network of this package: weights and biases must be floats")
    if any((weights.ndim, bias.ndim) != (2, 1) for weights, bias in layers):
        raise InputError(f"{path} contains no network of this package: weights must be matrices, and biases vectors")
    if not all(np.isfinite(array).all() for layer in layers for array in layer):
        raise InputError(f"{path} {DIVERGED}")
    for known in RULES:
        if rule == known:
            return TrainedNetwork([(w.astype(np.float64), b.astype(np.float64)) for w, b in layers], known)
    raise InputError(f"{path}: its policy decides by {rule!r}, but this version knows {' and '.join(RULES)}")


def write_network(path: Path, network: TrainedNetwork) -> None:
    """Write a network with float32 arrays."""
    arrays = {f"weights_{i}": weights.astype(np.float32) for i, (weights, _) in enumerate(network.layers)}
    arrays |= {f"bias_{i}": bias.astype(np.float32) for i, (_, bias) in enumerate(network.layers)}
    with new_file(path) as file:
        np.savez_compressed(file, allow_pickle=False, **arrays, **{_RULE: np.array(network.rule)})
