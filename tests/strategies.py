"""Random values for property tests."""

import math
from collections.abc import Callable, Iterator, Mapping
from functools import reduce
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy

from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.data.trace import ENDS, Trace

seeds = st.integers(0, 2**32 - 1)


def scenarios(logical: ScriptedLogicalScenario) -> st.SearchStrategy[ScriptedScenario]:
    return seeds.map(lambda seed: logical.sample(np.random.default_rng(seed)))


def random_trace(seed: int, frames: int = 20, npcs: int = 3, decisions: int = 10) -> Trace:
    """A trace of vehicles that wander about; nothing in it is meant to be physical."""
    rng = np.random.default_rng(seed)
    vehicles = 1 + npcs
    return Trace(
        time=np.arange(frames) * 0.05,
        position=np.cumsum(rng.normal(0, 1, (frames, vehicles, 2)), axis=0) + rng.normal(0, 8, (vehicles, 2)),
        heading=np.cumsum(rng.normal(0, 0.1, (frames, vehicles)), axis=0) + rng.uniform(-4, 4, vehicles),
        velocity=rng.normal(0, 5, (frames, vehicles, 2)),
        size=rng.uniform(1.5, 9, (vehicles, 2)),
        actions=rng.uniform(-1, 1, (decisions, 2)),
        action_frame=np.sort(rng.integers(0, frames, decisions)),
        route=np.stack([np.linspace(0, 50, 51), np.zeros(51)], axis=1),
        destination=rng.normal(0, 30, 2),
        illegal_lines=rng.normal(0, 15, (6, 2, 2)),
        end=ENDS[rng.integers(len(ENDS))],
        decisions={"code": rng.integers(0, 5, decisions).astype(float)},
    )


ODD_NUMBERS = (-0.0, 5e-324, 1e308, -1e308, math.nan, math.inf, -math.inf, 2**63, -(2**63), 2**70, 10**400)
ODD_TEXTS = ("", "\0", "\x1b[2J", "a\nb\r\u2028c", "\u202ecba", "\ud800", "../..", "1e400", "x" * 5000, ":", "[red]")
numbers = st.sampled_from(ODD_NUMBERS) | st.integers(-3, 20_000) | st.floats() | st.booleans()
texts = st.sampled_from(ODD_TEXTS) | st.text(st.characters(), max_size=20)  # surrogates included
leaves = st.none() | numbers | texts
values = st.one_of(
    leaves,
    st.recursive(leaves, lambda part: st.lists(part, max_size=4) | st.dictionaries(texts, part, max_size=3)),
    st.integers(1, 990).map(lambda depth: reduce(lambda inner, _: [inner], range(depth), 0)),
)


@st.composite
def changed(draw: st.DrawFn, value: Any) -> Any:
    """JSON values like one: up to three of its parts replaced, left out, added, repeated, or put elsewhere."""
    for _ in range(draw(st.sampled_from((1, 1, 1, 2, 3)))):
        parts = dict(_parts(value))
        path = draw(st.sampled_from(list(parts)))
        edit = draw(st.sampled_from(("replace", "drop", "add", "repeat", "number", "number", "move")))
        value = _edited(value, path, edit, draw, parts)
    return value


def _parts(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """The parts of a JSON value by where they are, itself among them."""
    yield path, value
    keys = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        yield from _parts(value[key], (*path, key))


def _edited(value: Any, path: tuple[Any, ...], edit: str, draw: st.DrawFn, parts: Mapping[Any, Any]) -> Any:
    if path:
        key, *rest = path
        copy = dict(value) if isinstance(value, dict) else list(value)
        if edit == "drop" and not rest:
            del copy[key]
        else:
            copy[key] = _edited(value[key], tuple(rest), edit, draw, parts)
        return copy
    if edit == "move":
        return draw(st.sampled_from(list(parts.values())))
    if edit == "add" and isinstance(value, dict):
        return {**value, draw(texts): draw(values)}
    if edit in ("add", "repeat") and isinstance(value, list):
        return value * draw(st.sampled_from((0, 2, 3, 1000))) + draw(st.lists(values, max_size=1))
    if edit == "number" and isinstance(value, int | float):
        return draw(st.sampled_from((-1, 0, 1, 2, 3, 100, 10_000, 0.5, value * 2, -value)) | numbers)
    return draw(values)


@st.composite
def changed_arrays(draw: st.DrawFn, named: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Arrays by name, one or two of them of other shapes, kinds or values, or missing."""
    arrays = named()
    for name in draw(st.lists(st.sampled_from(sorted(arrays)), min_size=1, max_size=2, unique=True)):
        edit = draw(st.sampled_from(("shape", "kind", "value", "any", "drop")))
        array = np.asarray(arrays.pop(name))
        if edit == "shape":
            arrays[name] = np.resize(array, draw(numpy.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5)))
        elif edit == "kind":
            kind = draw(st.sampled_from(("S3", "U3", "?", "u1", "i8", "f2", "f8", "c16", "M8[s]")))
            arrays[name] = np.resize(np.ones(1).astype(kind), array.shape)
        elif edit == "value" and array.dtype.kind == "f":
            odd = draw(st.sampled_from([number for number in ODD_NUMBERS if isinstance(number, float)]))
            arrays[name] = np.where(np.arange(array.size).reshape(array.shape) == 1, odd, array.astype(float))
        elif edit != "drop":
            arrays[name] = draw(numpy.arrays(numpy.scalar_dtypes(), numpy.array_shapes(max_side=5)))
    return arrays


FLAGS = {  # of each command, with arguments that it surely refuses: nothing is run
    "fuzz": (
        ("--env", "--ads", "--method", "--config", "--budget", "--batch", "--trust", "--out", "--resume"),
        "--seed=-1",
    ),
    "replay": (("--out",), "-1"),
    "records": ((), "--run=nowhere"),
    "triage": (("--workers",), "--workers=-1"),
    "report": (("--out",), "--replays=-1"),
    "evaluate": (("--env", "--ads", "--scenarios", "--trust", "--json"), "--seed=-1"),
    "bench": (("--out",), "--jobs=0"),
}


@st.composite
def command_lines(draw: st.DrawFn) -> list[str]:
    """Commands with any text where names, numbers, files and folders are expected."""
    words = texts | numbers.map(lambda number: "1" + "0" * 400 if number == 10**400 else str(number))
    command = draw(st.sampled_from(list(FLAGS)))
    flags, refused = FLAGS[command]
    given = draw(st.lists(words, max_size=2))
    for flag in draw(st.lists(st.sampled_from(flags), max_size=3)) if flags else ():
        given += [flag, draw(words)]
    return [command, *given, refused]
