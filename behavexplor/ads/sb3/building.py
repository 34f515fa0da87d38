"""Policy networks of Stable-Baselines3 made from settings and weights."""

import inspect
import io
import pickle
from collections.abc import Mapping, Sequence
from importlib import import_module
from itertools import pairwise
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.policies import BasePolicy

from behavexplor.ads.sb3.archive import Archive
from behavexplor.ads.sb3.inert import Inert, as_array
from behavexplor.errors import InputError

# Where the classes live that a policy may be built from; anything else is code that came with the file.
_KNOWN = ("stable_baselines3.", "sb3_contrib.", "torch.nn.modules.activation.", "torch.optim.")
_SPACES = {"Box", "Discrete", "MultiDiscrete", "MultiBinary"}


class UntrustedError(ValueError):
    """The policy cannot be made without running code that its file contains; the message says for what."""


def build_policy(archive: Archive) -> BasePolicy:
    """The policy of a model's file, from its plain settings and its weights alone.

    Raises:
        UntrustedError: if its classes are none of Stable-Baselines3, sb3-contrib or torch.
        InputError: if settings or weights are damaged or do not fit each other.
    """
    settings = archive.settings
    try:
        policy_class = _class(settings.get("policy_class"))
        keywords = dict(_value(settings.get("policy_kwargs") or {}))
        spaces = [_space(settings.get(f"{kind}_space")) for kind in ("observation", "action")]
    except UntrustedError:
        raise
    except (ValueError, TypeError, AttributeError, KeyError, IndexError) as error:
        raise InputError(f"{archive.path} cannot be read: {error}") from None
    return assemble(archive, policy_class, spaces[0], spaces[1], keywords)


def build_trusted(archive: Archive) -> BasePolicy:
    """The same with everything that the file contains, which runs code from it.

    Raises:
        InputError: if it cannot be loaded.
    """
    from stable_baselines3.common.save_util import load_from_zip_file  # noqa: PLC0415 - only where code may run

    try:
        data, _, _ = load_from_zip_file(str(archive.path), device="cpu")
    except Exception as error:  # the file's own code can raise anything
        raise InputError(f"{archive.path} cannot be loaded: {type(error).__name__}: {error}") from error
    saved = data or {}
    names = ("policy_class", "observation_space", "action_space", "policy_kwargs")
    policy_class, observation_space, action_space, keywords = (saved[name] for name in names)
    return assemble(archive, policy_class, observation_space, action_space, keywords)


def assemble(
    archive: Archive,
    policy_class: type[BasePolicy],
    observation_space: gymnasium.Space[Any],
    action_space: gymnasium.Space[Any],
    keywords: Mapping[str, Any],
) -> BasePolicy:
    """Make the policy and put the weights in.

    Raises:
        InputError: if the weights are damaged, or those of another policy.
    """
    _check_size(archive, (observation_space, action_space), keywords.get("net_arch"))
    accepted = inspect.signature(policy_class).parameters
    given = {key: value for key, value in keywords.items() if not key.startswith("optimizer")}
    if "lr_schedule" in accepted:
        given["lr_schedule"] = lambda _: 0.0
    if "use_sde" in accepted:
        given.setdefault("use_sde", bool(archive.settings.get("use_sde", False)))
    try:
        policy = policy_class(observation_space, action_space, **given)
        weights = torch.load(io.BytesIO(archive.weights), map_location="cpu", weights_only=True)
        policy.load_state_dict(weights)
    except pickle.UnpicklingError as error:
        first = str(error).split("\n", maxsplit=1)[0]
        raise InputError(f"{archive.path}: its weights hold more than weights, which was not run: {first}") from None
    except Exception as error:  # whatever torch and a policy class make of wrong values
        first = str(error).split("\n", maxsplit=1)[0]
        raise InputError(f"{archive.path}: its weights and settings do not fit each other: {first}") from error
    policy.set_training_mode(False)
    return policy


def _check_size(archive: Archive, spaces: Sequence[gymnasium.Space[Any]], net_arch: Any) -> None:
    """Refuse, before it is made, a network with more weights than there are bytes of them.

    Raises:
        InputError: if it has, or its layers are not described by their widths.
    """
    if isinstance(net_arch, list) and net_arch and isinstance(net_arch[0], Mapping):  # as earlier versions wrote it
        net_arch = net_arch[0]
    layers = list(net_arch.values()) if isinstance(net_arch, Mapping) else [net_arch or []]
    if not all(isinstance(widths, list | tuple) and all(type(width) is int for width in widths) for widths in layers):
        raise InputError(f"{archive.path}: its net_arch must be widths of layers, or lists of them by name")
    count = sum(sum(widths) + sum(before * after for before, after in pairwise(widths)) for widths in layers)
    if max(count, *(gymnasium.spaces.flatdim(space) for space in spaces)) > len(archive.weights):
        raise InputError(f"{archive.path}: its weights are too few for the network that its settings describe")


def _class(reference: Any) -> type[BasePolicy]:
    found = _known(reference)
    if not (isinstance(found, type) and issubclass(found, BasePolicy)):
        raise UntrustedError(
            f"its policy is {_name(reference)}, which is no policy of Stable-Baselines3 or sb3-contrib"
        )
    return found


def _known(reference: Any) -> Any:
    """What a name refers to, if it is one from which policies are ordinarily built."""
    name = _name(reference)
    if not (isinstance(reference, type) and name.startswith(_KNOWN)):
        raise UntrustedError(f"it needs {name}")
    module, _, attribute = name.rpartition(".")
    found = getattr(import_module(module), attribute)
    if not isinstance(found, type):
        raise UntrustedError(f"it needs {name}")
    return found


def _name(reference: Any) -> str:
    return reference.name if isinstance(reference, Inert) or _is_name(reference) else repr(reference)[:80]


def _is_name(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, Inert)


def _value(value: Any) -> Any:
    """Plain values, with names of known classes replaced by these."""
    if isinstance(value, dict):
        return {key: _value(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(map(_value, value))
    if isinstance(value, Inert):
        raise UntrustedError(f"it needs what {value.name} makes")
    return _known(value) if _is_name(value) else value


def _space(value: Any) -> gymnasium.Space[Any]:
    kind = value.name.rpartition(".")[2] if isinstance(value, Inert) else None
    if kind not in _SPACES:
        raise UntrustedError(f"its spaces hold {_name(value)}")
    state = value.state if isinstance(value.state, dict) else dict(value.state[1] or {}) | dict(value.state[0] or {})
    if kind == "Box":
        low, high = as_array(state["low"]), as_array(state["high"])
        return gymnasium.spaces.Box(low, high, dtype=low.dtype.type)
    if kind == "Discrete":
        return gymnasium.spaces.Discrete(int(as_array(state["n"])), start=int(as_array(state.get("start", 0))))
    if kind == "MultiDiscrete":
        return gymnasium.spaces.MultiDiscrete(as_array(state["nvec"]).astype(np.int64))
    return gymnasium.spaces.MultiBinary(int(as_array(state["n"])))
