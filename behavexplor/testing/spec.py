"""Contract of specs of users, see `behavexplor.judge.robustness`."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any, Final

import numpy as np

from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.envs.making import make_env
from behavexplor.errors import InputError
from behavexplor.execution.simulation import logical_scenario
from behavexplor.judge.robustness import as_spec, load_spec
from behavexplor.judge.specs import judge
from behavexplor.testing.contract import ContractError, promise
from behavexplor.testing.environment import executed
from behavexplor.testing.synthetic import synthetic_trace

TRACES: Final = 20
_ACTIONS: Final = 10  # random actions in an executed episode; the last one lasts to its end


def check_spec(spec: Any, *, env: str = "intersection-straight", traces: int = TRACES) -> None:
    """Check that a spec gives a number for every trace, and the same number each time.

    Args:
        spec: a callable on a trace, or its name as for `--spec`.
        env: the environment whose scenarios give the traces. In an environment of highway-env, the traces are those of
            episodes with random actions, so they take some time.
        traces: number of traces, at least 1. In addition, the spec is called on a trace without NPCs, and on one of a
            single frame, as an ADS leaves it that fails in its first decision.

    Raises:
        ContractError: if a promise is broken.
        InputError: if there is no such spec or environment.
    """
    made = load_spec(spec) if isinstance(spec, str) else as_spec(spec)
    for trace in _traces(env, max(traces, 1)):
        _check(made, trace, "a trace")
    _check(made, _alone(trace), "a trace without NPCs")
    _check(made, trace.until(1, "error"), "a trace of a single frame")


def _traces(env: str, count: int) -> Iterator[Trace]:
    logical = logical_scenario(env)
    generator = np.random.default_rng(0)
    if isinstance(logical, ScriptedLogicalScenario):
        yield from (synthetic_trace(logical.sample(generator), logical) for _ in range(count))
        return
    with closing(make_env(env, {})) as made:
        made.action_space.seed(0)
        for _ in range(count):
            actions = [made.action_space.sample() for _ in range(_ACTIONS)]
            yield executed(made, logical.sample(generator), actions)


def _alone(trace: Trace) -> Trace:
    """Return a trace as if the ego had driven alone."""
    motion = {name: getattr(trace, name)[:, :1] for name in ("position", "heading", "velocity")}
    return replace(trace, **motion, size=trace.size[:1], present=trace.present[:, :1], partner=-1)


def _check(spec: Any, trace: Trace, what: str) -> None:
    try:
        first, again = (judge(trace, [spec]) for _ in range(2))
    except InputError as error:
        raise ContractError(f"On {what}: {error}") from error
    promise(
        dict(first.degrees) == dict(again.degrees) and first.violated == again.violated,
        f"{spec.name} gave another robustness when it was called on {what} again",
    )
