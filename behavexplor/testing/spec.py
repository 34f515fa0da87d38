"""Contract of specs of users, see `behavexplor.judge.robustness`."""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from behavexplor.data.scripted_logical import scripted
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError
from behavexplor.execution.simulation import logical_scenario
from behavexplor.judge.robustness import as_spec, load_spec
from behavexplor.judge.specs import judge
from behavexplor.testing.contract import ContractError, promise
from behavexplor.testing.synthetic import synthetic_trace

TRACES: Final = 20


def check_spec(spec: Any, *, env: str = "intersection-straight", traces: int = TRACES) -> None:
    """Check that a spec gives a number for every trace, and the same number each time.

    Args:
        spec: a callable on a trace, or its name as for `--spec`.
        env: the environment whose scenarios give the traces.
        traces: number of synthetic traces. Beside them it is called on a trace without NPCs, and on one of a single
            frame, as an ADS leaves it that fails in its first decision.

    Raises:
        ContractError: if a promise is broken.
        InputError: if there is no such spec or environment.
    """
    made = load_spec(spec) if isinstance(spec, str) else as_spec(spec)
    logical = scripted(logical_scenario(env), "A check of a spec")
    generator = np.random.default_rng(0)
    for _ in range(traces):
        _check(made, synthetic_trace(logical.sample(generator), logical), "a trace")
    scenario = logical.sample(generator)
    whole = synthetic_trace(scenario, logical)
    _check(made, synthetic_trace(replace(scenario, npcs=()), logical), "a trace without NPCs")
    _check(made, whole.until(1, "error"), "a trace of a single frame")


def _check(spec: Any, trace: Trace, what: str) -> None:
    try:
        first, again = (judge(trace, [spec]) for _ in range(2))
    except InputError as error:
        raise ContractError(f"On {what}: {error}") from error
    promise(
        dict(first.degrees) == dict(again.degrees) and first.violated == again.violated,
        f"{spec.name} gave another robustness when it was called on {what} again",
    )
