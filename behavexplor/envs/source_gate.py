"""Check that the classes that run are those that the compiled engines stand for.

An engine was ported from highway-env's classes and from those of this package. Another release of highway-env may drive
differently, and so may a program that replaces a method or a constant of a class while it runs. `source_digests.json`
has what was ported: for each class of highway-env, and for some of its modules, the digest of the source of every
function, and the value of every constant.
"""

import ast
import hashlib
import json
import sys
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import CodeType, FunctionType, MappingProxyType, ModuleType
from typing import Any, Final, Self, TypeAlias

import highway_env.envs.common.action as actions
import highway_env.envs.common.finite_mdp as grids
import highway_env.envs.common.observation as observations
import numpy as np
from highway_env import utils
from highway_env.envs.common.abstract import AbstractEnv

from behavexplor.errors import InputError

Owner: TypeAlias = type | ModuleType  # what has functions and constants
Ported: TypeAlias = dict[str, dict[str, dict[str, str]]]  # digest or value by module, class ("": none) and name

MODULES: Final = (utils, grids, observations, actions)  # whose functions were ported, too
_DRAWING: Final = frozenset(  # attributes of an environment that change pictures only
    {"metadata", "render", "close", "update_metadata", "set_record_video_wrapper", "_automatic_rendering"}
)
REWARDS: Final = frozenset({"_reward", "_rewards"})  # methods for the reward, which drivers are not told
# Parameters of `IDMVehicle`, each with its own value and with the one that `IntersectionEnv` sets in this class.
OF_INTERSECTION: Final = MappingProxyType(
    {"DISTANCE_WANTED": (10.0, 7), "COMFORT_ACC_MAX": (3.0, 6), "COMFORT_ACC_MIN": (-5.0, -3)}
)
# What `default_config` returns is read when an engine is made; `track_config_path` only words errors about it.
_SKIPPED: Final = _DRAWING | {"_abc_impl", "default_config", "track_config_path"}
_PACKAGES: Final = ("highway_env", "behavexplor", "gymnasium")  # whose classes are compared with what was ported
_RARELY: Final = 8  # `ChangeGuard.check` may look at only one in so many calls
_PORTED: Final = Path(__file__).with_name("source_digests.json")
_VALUE: Final = "= "  # before a value, which may look like a digest otherwise


def classes_of(env: AbstractEnv, vehicles: Iterable[type], *, with_observation: bool = True) -> tuple[type, ...]:
    """Return the classes that an environment and its vehicles consist of, with their parents."""
    lanes = {type(lane): None for lane in env.road.network.lanes_list()}
    things = [env, env.road, env.road.network, *([env.observation_type] if with_observation else []), env.action_type]
    parents = {parent: None for one in (*map(type, things), *lanes, *vehicles) for parent in one.__mro__}
    return tuple(parent for parent in parents if _package(parent) not in ("builtins", "typing", "abc"))


def changes(classes: Iterable[type], read: Collection[str] = ()) -> tuple[str, ...]:
    """Return the names of functions and constants of classes that are others than those that were ported.

    `read` names constants that an engine reads when it is made, so they may be others. A class of a user's own package
    has no changes: whether the engine supports it is checked elsewhere.
    """
    pairs = ((owner, name) for owner in (*classes, *MODULES) for name in _changes_of(owner) if name not in read)
    return *(f"{_short(owner)}.{name}" for owner, name in pairs), *_changed_imports()


def replaced(cls: type, known: type, allowed: Collection[str] = ()) -> str | None:
    """Return what a subclass of `known` replaces but may not, such as "MyEnv.step"; None if there is nothing."""
    attributes = {name for parent in known.__mro__ for name in _attributes(parent)}
    free = {*allowed, "__str__", "__repr__"}
    for base in cls.__mro__[: cls.__mro__.index(known)]:
        for name, value in vars(base).items():
            hides = hasattr(type(value), "__set__") and name in attributes  # as a property does
            if name not in free and _is_rule(name, value) and (hasattr(known, name) or hides):
                return f"{base.__name__}.{name}"
    return None


def replaced_in(env: object, allowed: Collection[str] = ()) -> str | None:
    """Return the name of a method that a program has replaced in an object, such as "HighwayEnv._reward", or None."""
    for name in vars(env).keys() - _DRAWING - set(allowed):
        parent = next((parent for parent in type(env).__mro__ if name in vars(parent)), None)
        if parent is not None and _codes(vars(parent)[name]) is not None:
            return f"{type(env).__name__}.{name}"
    return None


def _attributes(cls: type) -> tuple[str, ...]:
    """Return names in the constructor of a class, among them those of the attributes of its objects."""
    constructor = vars(cls).get("__init__")
    return constructor.__code__.co_names if isinstance(constructor, FunctionType) else ()


class ChangedError(InputError):
    """Functions or constants are others than those that the compiled engine was ported from."""

    def __init__(self, names: Sequence[str]) -> None:
        others = ", ".join(name.removesuffix(".__class__") for name in names[:3])
        self.reason = f"compiled engine was ported from another {others} than the one that runs here"
        super().__init__(f"The {self.reason}; use gymnasium.make_vec with vectorization_mode='sync' for the original")


class ChangeGuard:
    """Notices that classes change after an environment was made from them.

    An `IntersectionEnv` that is made or reset elsewhere in the process changes nothing that counts: the compiled
    environment keeps the parameters that its vehicles had when it was made. Names in `exempt` may change, too.
    """

    def __init__(self, classes: Iterable[type], exempt: frozenset[str] = frozenset()) -> None:
        self._classes, self._exempt, self._n_calls = tuple(classes), exempt, 0
        self._views = [vars(owner).values() for owner in (*self._classes, *MODULES)]  # which follow every change
        self._values = tuple(map(tuple, self._views))
        self._facts, self._texts = self._present_facts(), self._present_texts()

    def check(self, *, always: bool = True) -> None:
        """Check that nothing has changed.

        Unless `always`, it looks only at every eighth call, since a look takes some microseconds.

        Raises:
            InputError: if something has changed. The message names it.
        """
        self._n_calls += 1
        if not always and self._n_calls % _RARELY:
            return
        try:
            if tuple(map(tuple, self._views)) == self._values:
                return
        except ValueError:  # an array was replaced by another one
            pass
        facts = self._present_facts()
        names = [name for name in self._facts.keys() | facts.keys() if self._facts.get(name) != facts.get(name)]
        if names:
            raise InputError(
                f"{', '.join(sorted(names)[:3])} changed after the compiled environment was made: make the environment "
                f"again, or use gymnasium.make_vec with vectorization_mode='sync'"
            )
        self._values = tuple(map(tuple, self._views))

    def is_current(self) -> bool:
        """Return whether nothing has changed, also within lists, dictionaries and arrays."""
        try:
            self.check()
        except InputError:
            return False
        return self._texts == self._present_texts()

    def _present_texts(self) -> list[str]:
        return [_text(value) for view in self._views for value in view if type(value) in (list, dict, np.ndarray)]

    def _present_facts(self) -> dict[str, object]:
        return {
            f"{_short(owner)}.{name}": _codes(value) or _text(value)
            for owner in (*self._classes, *MODULES)
            for name, value in vars(owner).items()
            if name not in self._exempt and _matters(owner, name, value) and not _is_of_intersection(name, value)
        }

    def __deepcopy__(self, _: object) -> Self:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._classes, self._exempt)


_guards: dict[tuple[tuple[type, ...], frozenset[str]], ChangeGuard] = {}


def guard_of(
    classes: tuple[type, ...], read: Collection[str] = (), exempt: frozenset[str] = frozenset()
) -> ChangeGuard:
    """Check that an environment consists of what the engine was ported from, and return the guard of its classes.

    `read` names constants that the engine reads, which may be others; those in `exempt` may also change later. A guard
    that was made before is taken again if nothing has changed, since the comparison takes milliseconds.

    Raises:
        ChangedError: if a function or constant is another one. The message names it.
    """
    known = _guards.get((classes, exempt))
    if known is None or any(_changed_imports()) or not known.is_current():
        names = changes(classes, read)
        if names:
            raise ChangedError(names)
        known = _guards[classes, exempt] = ChangeGuard(classes, exempt)
    return known


def _matters(owner: Owner, name: str, value: object) -> bool:
    """Return whether a name may change how an environment behaves.

    Attributes in which a user's class keeps its own state do not.
    """
    if not _is_rule(name, value):
        return False
    if isinstance(owner, ModuleType):
        return type(value) is FunctionType and value.__module__ == owner.__name__  # `isinstance` loads late modules
    replaces = any(name in vars(parent) for parent in owner.__mro__[1:])
    return _package(owner) in _PACKAGES or _codes(value) is not None or replaces


def _is_of_intersection(name: str, value: object) -> bool:
    return name in OF_INTERSECTION and any(value is known or value == known for known in OF_INTERSECTION[name])


def _is_rule(name: str, value: object) -> bool:
    is_internal = name.startswith("__") and not _codes(value) and not callable(value)  # such as __doc__
    return name not in _SKIPPED and not is_internal


def _changes_of(owner: Owner) -> Iterator[str]:
    """Yield the names in a class or a module that stand for something else than what was ported."""
    module, package = _module(owner), _package(owner)
    if package not in _PACKAGES:
        return
    ported = ported_sources().get(module, {}).get(_qualname(owner))
    if package == "highway_env" and ported is None:
        yield "__class__"  # a class that the engine does not know
        return
    ported = ported or {}
    present = {name: value for name, value in vars(owner).items() if _matters(owner, name, value)}
    digests = _digests(module) if package == "highway_env" else {}
    for name in sorted(present.keys() | ported.keys()):
        if name not in present or not _is_ported(owner, name, present[name], ported.get(name), digests):
            yield name


def _changed_imports() -> Iterator[str]:
    """Yield the names of imported classes and functions in highway-env's modules that have been replaced by others."""
    homes: dict[str, str] = {}
    for module, classes in ported_sources().items():
        for name, members in classes.items():
            homes |= dict.fromkeys([name] if name else members, module)
    for module in ported_sources():
        loaded = sys.modules.get(module)
        for name, value in vars(loaded).items() if loaded else ():
            home = sys.modules.get(homes.get(name, module))
            if home is not loaded and value is not getattr(home, name, value):
                yield f"{module.rpartition('.')[2]}.{name}"


def _is_ported(owner: Owner, name: str, value: object, ported: str | None, digests: dict[str, str]) -> bool:
    """Return whether a function or constant is the one that was ported.

    What was not ported must stand in the file of its class. In highway-env, it must be new there, and replace nothing.
    """
    path = f"{_qualname(owner)}.{name}".lstrip(".")
    codes = _codes(value)
    if ported is None:
        replaces = any(name in vars(parent) for parent in getattr(owner, "__mro__", ())[1:])
        return not (replaces and _package(owner) == "highway_env") and _is_in_file(_module(owner), path, codes)
    if codes is None:
        return ported == _VALUE + _text(value)
    return ported == digests.get(path) and _is_in_file(_module(owner), path, codes)


def _is_in_file(module: str, path: str, codes: list[CodeType] | None) -> bool:
    """Return whether a function, or a constant (which has no codes), is the one in the file of its module."""
    known = _file_codes(module)
    if codes is None:
        owner, _, name = path.rpartition(".")
        return any(name in code.co_names for code in known.get(owner, ()))
    return all(any(_are_same(code, one) for one in known.get(path, ())) for code in codes)


def _are_same(code: CodeType, other: CodeType) -> bool:
    """Return whether two codes are equal, with those of the functions in them, wherever their files are."""
    names = ("co_code", "co_names", "co_varnames", "co_freevars", "co_flags", "co_firstlineno")
    if any(getattr(code, name) != getattr(other, name) for name in names):
        return False
    pairs = zip(code.co_consts, other.co_consts, strict=False)
    return len(code.co_consts) == len(other.co_consts) and all(
        _are_same(one, two) if isinstance(one, CodeType) and isinstance(two, CodeType) else one == two
        for one, two in pairs
    )


def _codes(value: object) -> list[CodeType] | None:
    """Return the code of a function, or of the functions of a method or property; None for anything else."""
    parts: list[object] = [value.__func__ if isinstance(value, classmethod | staticmethod) else value]
    if isinstance(value, property):
        parts = [part for part in (value.fget, value.fset, value.fdel) if part is not None]
    codes = [part.__code__ for part in parts if isinstance(part, FunctionType)]
    return codes if len(codes) == len(parts) else None


def _text(value: object) -> str:
    return repr(value.tolist() if isinstance(value, np.ndarray) else value)


def _module(owner: Owner) -> str:
    return owner.__name__ if isinstance(owner, ModuleType) else owner.__module__


def _package(owner: Owner) -> str:
    return _module(owner).partition(".")[0]


def _qualname(owner: Owner) -> str:
    return "" if isinstance(owner, ModuleType) else owner.__qualname__


def _short(owner: Owner) -> str:
    return owner.__name__.rpartition(".")[2]


@cache
def ported_sources() -> Ported:
    """Return what was ported."""
    return dict(json.loads(_PORTED.read_text()))


@cache
def _digests(module: str) -> dict[str, str]:
    """Return the digests of the sources of the functions in the file of a module, by class and name."""
    spec = find_spec(module)
    source = "" if spec is None or spec.origin is None else Path(spec.origin).read_text(encoding="utf-8")
    lines = source.splitlines()
    found: dict[str, str] = {}
    for name, node in _functions(ast.parse(source)):
        earlier = found.get(name, "")  # digest of the getter of a property, if this is its setter
        text = "\n".join(lines[node.lineno - 1 : node.end_lineno])
        found[name] = hashlib.sha256((earlier + text).encode()).hexdigest()[:16]
    return found


def _functions(tree: ast.Module | ast.ClassDef, prefix: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    """Yield the functions of a module and of its classes, with their qualified names."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield from _functions(node, f"{prefix}{node.name}.")
        elif isinstance(node, ast.FunctionDef):
            yield f"{prefix}{node.name}", node


@cache
def _file_codes(module: str) -> dict[str, list[CodeType]]:
    """Return the code of all functions and classes in the file of a module, by class and name; "" is the module."""
    spec = find_spec(module)
    whole = None if spec is None or spec.loader is None else spec.loader.get_code(module)  # type: ignore[attr-defined]
    found: dict[str, list[CodeType]] = {"": [] if whole is None else [whole]}
    waiting = list(found[""])
    while waiting:
        for part in waiting.pop().co_consts:
            if isinstance(part, CodeType):
                found.setdefault(part.co_qualname, []).append(part)
                waiting.append(part)
    return found
