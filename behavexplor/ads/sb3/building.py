"""Build policy networks of Stable-Baselines3 from settings and weights."""

import inspect
import io
import pickle
import re
import sys
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from importlib import import_module
from itertools import pairwise
from opcode import opmap
from types import FunctionType
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.policies import BasePolicy

from behavexplor.ads.sb3.archive import WEIGHTS, Archive
from behavexplor.ads.sb3.arrays import as_array, as_mapping
from behavexplor.ads.sb3.inert import Inert, Name
from behavexplor.errors import InputError, brief, sentence

# Modules whose classes a policy may be built from; any other class is code that came with the file.
_KNOWN = ("stable_baselines3.", "sb3_contrib.", "torch.nn.modules.activation.", "torch.optim.")
_NEEDED = ("policy_class", "observation_space", "action_space")
_UNREADABLE = (ValueError, TypeError, AttributeError, KeyError, IndexError, OverflowError)  # what wrong settings raise
MOST_LAYERS = 100  # of one network
_LEAST_DEFAULT = 64  # weights of a network whose layers are not given, at least
_HERE = f"{sys.version_info.major}.{sys.version_info.minor}"  # version of Python
_OWN_CLASS = ("cloudpickle.cloudpickle._make_skeleton_class", "cloudpickle.cloudpickle_fast._make_skeleton_class")
_SPACES = re.compile(r"(gymnasium|gym)\.spaces\.(\w+\.)*(\w+)$")


class UntrustedError(ValueError):
    """The policy cannot be built without executing code from its file; the message says what needs this code."""


def build_policy(archive: Archive) -> BasePolicy:
    """Build the policy of a model's file from its plain settings and its weights alone.

    Raises:
        UntrustedError: if a class is not from Stable-Baselines3, sb3-contrib or torch.
        InputError: if settings or weights are damaged or do not fit each other.
    """
    policy_class, keywords = policy_recipe(archive)
    try:
        spaces = [_space(archive.settings.get(f"{kind}_space")) for kind in ("observation", "action")]
    except UntrustedError:
        raise
    except _UNREADABLE as error:
        raise InputError(f"{archive.path} cannot be read: {error}") from None
    return assemble(archive, policy_class, spaces[0], spaces[1], keywords)


def policy_recipe(archive: Archive) -> tuple[type[BasePolicy], dict[str, Any]]:
    """Return the class of a model's policy and its keyword arguments.

    Raises:
        UntrustedError: if a class is not from Stable-Baselines3, sb3-contrib or torch.
        InputError: if the settings are damaged.
    """
    _check_complete(archive, archive.settings)
    try:
        policy_class = _class(archive.settings.get("policy_class"))
        return policy_class, dict(_value(archive.settings.get("policy_kwargs") or {}))
    except UntrustedError:
        raise
    except _UNREADABLE as error:
        raise InputError(f"{archive.path} cannot be read: {error}") from None


def build_trusted(archive: Archive) -> BasePolicy:
    """Build the policy from everything in a model's file, which executes code from it.

    Raises:
        InputError: if the file cannot be loaded.
    """
    from stable_baselines3.common.save_util import load_from_zip_file  # noqa: PLC0415 - only where code may run

    _check_python(archive)
    try:
        data, _, _ = load_from_zip_file(io.BytesIO(archive.packed), device="cpu")  # the bytes whose digest is trusted
    except Exception as error:  # the file's own code can raise anything
        raise InputError(f"{archive.path} cannot be loaded: {type(error).__name__}: {error}") from error
    saved = data or {}
    if lost := [name for name in _NEEDED if saved.get(name) is None and isinstance(archive.settings.get(name), Inert)]:
        raise InputError(
            f"{archive.path}: its {lost[0]} is {_name(archive.settings[lost[0]])}, which cannot be loaded here: is it "
            f"code of another version than Python {_HERE}, or is a module missing?"
        )
    _check_complete(archive, saved)
    policy_class, observation_space, action_space = (saved[name] for name in _NEEDED)
    if isinstance(archive.settings.get("policy_class"), Inert) and _is_foreign(policy_class):
        raise InputError(
            f"{archive.path} contains {_name(archive.settings['policy_class'])} as code of another version than Python "
            f"{_HERE}, although its system_info.txt may say otherwise: save the model again where that class can be "
            "imported"
        )
    return assemble(archive, policy_class, observation_space, action_space, saved.get("policy_kwargs") or {})


def _check_python(archive: Archive) -> None:
    """Refuse a policy whose class is in the file, as code of another version of Python, which may end the process."""
    policy_class = archive.settings.get("policy_class")
    if archive.python not in ("", _HERE) and isinstance(policy_class, Inert):
        raise InputError(
            f"{archive.path} contains {_name(policy_class)} as code of Python {archive.python}, which Python {_HERE} "
            f"cannot run: use Python {archive.python}, or save the model again where that class can be imported"
        )


def _is_foreign(kind: object) -> bool:
    """Return whether a class has functions of another version of Python, which may end the process.

    Every function has the instruction RESUME, whose number differs: 151 in Python 3.11 and 3.12, and 149 in 3.13.
    """
    functions = [one for one in getattr(kind, "__dict__", {}).values() if isinstance(one, FunctionType)]
    return any(opmap["RESUME"] not in one.__code__.co_code[::2] for one in functions)


def _check_complete(archive: Archive, settings: Mapping[str, Any]) -> None:
    """Refuse settings without those that every model of Stable-Baselines3 has."""
    if missing := [name for name in _NEEDED if settings.get(name) is None]:
        raise InputError(f"{archive.path} is not a model of Stable-Baselines3: its data has no {', '.join(missing)}")


class _NoOptimizer:
    """Takes the place of an optimizer. Driving needs none, and those of torch take seconds to import."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass


def assemble(
    archive: Archive,
    policy_class: type[BasePolicy],
    observation_space: gymnasium.Space[Any],
    action_space: gymnasium.Space[Any],
    keywords: Mapping[str, Any],
) -> BasePolicy:
    """Build the policy and load its weights.

    Raises:
        InputError: if the weights are damaged or belong to another policy.
    """
    _check_size(archive, (observation_space, action_space), keywords)
    try:
        use_sde = bool(archive.settings.get("use_sde", False))
        policy = new_policy(policy_class, observation_space, action_space, keywords, use_sde=use_sde)
        weights = torch.load(io.BytesIO(archive.weights), map_location="cpu", weights_only=True)
        policy.load_state_dict(weights)
    except pickle.UnpicklingError:
        found = [phrase for phrase in archive.suspicions if phrase.startswith(WEIGHTS)]
        message = f"{archive.path}: its weights contain objects other than tensors, which were not loaded"
        raise InputError(": ".join([message, *found[:1]])) from None
    except Exception as error:  # torch and policy classes can raise anything for wrong values
        beginning = " ".join(str(error).split("\n", maxsplit=2)[:2])  # torch says what differs in the second line
        raise InputError(
            f"{archive.path}: its weights and settings do not fit each other: {sentence(beginning):.400}"
        ) from error
    policy.set_training_mode(False)
    return policy


def new_policy(
    policy_class: type[BasePolicy],
    observation_space: gymnasium.Space[Any],
    action_space: gymnasium.Space[Any],
    keywords: Mapping[str, Any],
    *,
    use_sde: bool,
) -> BasePolicy:
    """Make a policy as its algorithm does, without an optimizer where that is possible."""
    accepted = _accepted(policy_class)
    given = {key: value for key, value in keywords.items() if not key.startswith("optimizer")}
    if "optimizer_class" in accepted and policy_class.__module__.startswith(_KNOWN):
        given["optimizer_class"] = _NoOptimizer
    if "use_sde" in accepted:
        given.setdefault("use_sde", use_sde)
    if "ortho_init" in accepted:
        given["ortho_init"] = False  # it takes long for large layers, and the weights are loaded afterwards
    schedule = [lambda _: 0.0] if "lr_schedule" in accepted else []  # the third argument, as algorithms give it
    return policy_class(observation_space, action_space, *schedule, **given)


def _accepted(policy_class: type[BasePolicy]) -> set[str]:
    """Return the names of the arguments that a policy takes, with those that it passes on to its base classes."""
    names: set[str] = set()
    for kind in policy_class.__mro__:
        if "__init__" in vars(kind):
            parameters = inspect.signature(vars(kind)["__init__"]).parameters
            names |= parameters.keys()
            if not any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters.values()):
                break
    return names


def _check_size(archive: Archive, spaces: Sequence[gymnasium.Space[Any]], keywords: Mapping[str, Any]) -> None:
    """Refuse a network with more weights than its file has bytes, before the network is built."""
    net_arch = keywords.get("net_arch")
    if isinstance(net_arch, list) and net_arch and isinstance(net_arch[0], Mapping):  # format of earlier versions
        net_arch = net_arch[0]
    layers = list(net_arch.values()) if isinstance(net_arch, Mapping) else [net_arch or []]
    if not all(isinstance(widths, list | tuple) and all(type(width) is int for width in widths) for widths in layers):
        raise InputError(f"{archive.path}: its net_arch must be a list of layer widths, or a dictionary of such lists")
    if max(map(len, layers), default=0) > MOST_LAYERS:
        raise InputError(f"{archive.path}: its net_arch has more than {MOST_LAYERS} layers")
    count = sum(sum(widths) + sum(before * after for before, after in pairwise(widths)) for widths in layers)
    given = {key: value for key, value in keywords.items() if type(value) is int}
    memory = given.get("lstm_hidden_size", 0) ** 2 * given.get("n_lstm_layers", 1)
    critics = given.get("n_critics", 0) * (count or _LEAST_DEFAULT)
    outputs = given.get("n_quantiles", 0) * given.get("n_critics", 1)
    extractor = keywords.get("features_extractor_kwargs")
    features = [n for n in extractor.values() if type(n) is int] if isinstance(extractor, Mapping) else []
    widths = [gymnasium.spaces.flatdim(space) for space in spaces]
    if max(count, memory, critics, outputs, *features, *widths) > len(archive.weights):
        raise InputError(f"{archive.path}: its weights are too few for the network that its settings describe")


def _class(reference: Any) -> type[BasePolicy]:
    found = _known(reference)
    if not (isinstance(found, type) and issubclass(found, BasePolicy)):
        raise UntrustedError(
            f"its policy is {_name(reference)}, which is not a policy of Stable-Baselines3 or sb3-contrib"
        )
    return found


def _known(reference: Any) -> Any:
    """Return the class that a name refers to, if policies are ordinarily built from it."""
    name = _name(reference)
    if not (isinstance(reference, Name) and name.startswith(_KNOWN)):
        raise UntrustedError(f"it needs {name}")
    module, _, attribute = name.rpartition(".")
    try:
        found = getattr(import_module(module), attribute)
    except (ImportError, AttributeError):
        raise ValueError(f"it needs {name}, which the installed version does not have") from None
    if not isinstance(found, type):
        raise UntrustedError(f"it needs {name}")
    return found


def _name(reference: Any) -> str:
    if isinstance(reference, Inert) and reference.name in _OWN_CLASS and len(reference.arguments) > 1:
        return f"the class {brief(reference.arguments[1])} of its own"
    return reference.name if isinstance(reference, (Inert, Name)) else brief(reference)


def _value(value: Any) -> Any:
    """Return plain values, with the names of known classes replaced by the classes."""
    if isinstance(value, dict):
        return {key: _value(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(map(_value, value))
    if isinstance(value, Inert):
        raise UntrustedError(f"it needs an object made by {value.name}")
    return _known(value) if isinstance(value, Name) else value


def _space(value: Any) -> gymnasium.Space[Any]:
    """Return the space that a pickle describes: one array or number, or a dictionary of such spaces."""
    kind, state = _space_state(value)
    if kind != "Dict":
        return _plain_space(kind, state)
    spaces = as_mapping(state["spaces"]) or {}
    parts = [(str(key), _plain_space(*_space_state(part))) for key, part in spaces.items()]
    return gymnasium.spaces.Dict(OrderedDict(parts))  # the order matters: networks concatenate the parts


def _space_state(value: Any) -> tuple[str, Mapping[str, Any]]:
    """Return the kind of a space, such as "Box", and its attributes."""
    found = _SPACES.match(_name(value)) if isinstance(value, Inert) else None
    if found is None:
        raise UntrustedError(f"its spaces contain {_name(value)}")
    states = value.state if isinstance(value.state, tuple) else (value.state,)  # a state, or a pair with that of slots
    return found[3], {key: entry for state in states if isinstance(state, dict) for key, entry in state.items()}


def _plain_space(kind: str, state: Mapping[str, Any]) -> gymnasium.Space[Any]:
    if kind == "Box":
        low, high = as_array(state["low"]), as_array(state["high"])
        return gymnasium.spaces.Box(low, high, dtype=low.dtype.type)
    if kind == "Discrete":
        return gymnasium.spaces.Discrete(int(as_array(state["n"])), start=int(as_array(state.get("start", 0))))
    if kind == "MultiDiscrete":
        return gymnasium.spaces.MultiDiscrete(as_array(state["nvec"]).astype(np.int64))
    if kind == "MultiBinary":
        return gymnasium.spaces.MultiBinary(int(as_array(state["n"])))
    raise ValueError(f"a policy with a space of the kind {kind} at this place is not supported")
