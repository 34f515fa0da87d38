"""Contract of environments that can be fuzzed."""

from typing import Any, Final

import gymnasium
import numpy as np

from behavexplor.data.logical import LogicalScenario
from behavexplor.data.scenario import Scenario, parse_scenario
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.trace import ENDS, Trace
from behavexplor.envs.making import make_env
from behavexplor.errors import InputError
from behavexplor.execution.simulation import logical_scenario
from behavexplor.testing.contract import ContractError, promise

SCENARIOS: Final = 3
MOST_STEPS: Final = 100_000  # in which every episode must have ended


def check_env(env: str, *, scenarios: int = SCENARIOS) -> None:
    """Check that an environment executes concrete scenarios as a campaign asks it to.

    `gymnasium.utils.env_checker.check_env` checks the rest of an environment.

    Args:
        env: a functional scenario, or a gymnasium id.
        scenarios: number of scenarios that are executed.

    Raises:
        ContractError: if a promise is broken.
        InputError: if there is no such environment, or it has no `logical`.
    """
    logical = logical_scenario(env)
    made = make_env(env, {})
    made.action_space.seed(0)
    generator = np.random.default_rng(0)
    try:
        for _ in range(scenarios):
            scenario = _sampled(logical, generator)
            actions = [made.action_space.sample() for _ in range(10)]
            first, again = (executed(made, scenario, actions) for _ in range(2))
            promise(
                first.to_bytes() == again.to_bytes(),
                "The same scenario and actions gave another trace: nothing but the scenario may decide an episode",
            )
            _check_trace(first, scenario)
        _, info = made.reset(seed=0)
        promise("scenario" in info, 'reset without options must sample a scenario and return it as info["scenario"]')
    finally:
        made.close()


def _sampled(logical: LogicalScenario, generator: np.random.Generator) -> Scenario:
    scenario = logical.sample(generator)
    try:
        logical.check(scenario)
    except InputError as error:
        raise ContractError(f"`logical` sampled a scenario that it refuses: {error}") from error
    promise(parse_scenario(scenario.to_json()) == scenario, "A scenario must be the same after to_json and from_json")
    return scenario


def executed(env: gymnasium.Env[Any, Any], scenario: Scenario, actions: list[Any]) -> Trace:
    """Run a scenario to its end, with the last action again and again after the others, and return the trace.

    Raises:
        ContractError: if the environment breaks a promise.
    """
    _, info = env.reset(options={"scenario": scenario})
    promise(info.get("scenario") == scenario, 'reset must return the scenario that runs as info["scenario"]')
    for step in range(MOST_STEPS):
        _, _, terminated, truncated, info = env.step(actions[min(step, len(actions) - 1)])
        if terminated or truncated:
            break
    else:
        raise ContractError(f"The episode has not ended after {MOST_STEPS} steps")
    promise(isinstance(info.get("trace"), Trace), 'The last step must return the trace as info["trace"]')
    trace: Trace = info["trace"]
    return trace


def _check_trace(trace: Trace, scenario: Scenario) -> None:
    promise(
        not isinstance(scenario, ScriptedScenario) or len(trace.size) == 1 + len(scenario.npcs),
        f"The trace has {len(trace.size) - 1} vehicles beside the ego, which is not the scenario's number of NPCs",
    )
    promise(trace.end in ENDS, f"The trace ended with {trace.end!r}, which is none of {', '.join(ENDS)}")
    promise(Trace.from_bytes(trace.to_bytes()).to_bytes() == trace.to_bytes(), "The trace must survive to_bytes")
