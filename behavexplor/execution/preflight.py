"""Preflight: check a system under test before a campaign, so that mistakes in its setup show early."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.conventions import STANDING_SPEED
from behavexplor.data.observations import Observation, arrays_of, joined, mapped
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.asking import is_function
from behavexplor.execution.executor import ADSError
from behavexplor.execution.rollout import rollout, rollout_all
from behavexplor.execution.simulation import FILE, MEMORY, MODULE, Simulation

SCENARIOS: Final = 4
MARGIN: Final = 0.25  # tolerance beyond the range of observed values, as a share of that range
FOREIGN: Final = 0.4  # greatest tolerated share of values beyond it; early policies reach 0.32, lost statistics 0.8
_WHERE_CONFIGURED: Final = MappingProxyType(
    {
        FILE: "by --env-config FILE (in Python, env_config), or in a YAML file beside the model (config: ...)",
        MODULE: "by --env-config FILE (in Python, env_config), or as the driver's attribute env_config",
        MEMORY: "as env_config, or give an environment that has it instead of an id",
    }
)


class _Witness:
    """An ADS that also records its observations and actions, except those of absent egos, whose rows are zeros."""

    def __init__(self, ads: Any) -> None:
        self.ads = ads
        self.is_function = is_function(ads)
        self.observations: list[Observation] = []
        self.actions: list[NDArray[Any]] = []

    def predict(self, observation: Observation, *arguments: Any, **keywords: Any) -> Any:
        answer = self.ads.predict(observation, *arguments, **keywords)
        is_there = _rows_with_values(observation)
        self.observations.append(mapped(lambda array: np.array(array)[is_there], observation))
        self.actions.append(np.array(answer[0])[is_there])
        return answer


def _rows_with_values(observation: Observation) -> NDArray[np.bool_]:
    """Return which rows of an observation have any value but 0, shape (B,); all, if none has."""
    found = np.any([array.reshape(len(array), -1).any(axis=1) for array in arrays_of(observation)], axis=0)
    return np.asarray(found | ~found.any())


def preflight_warnings(simulation: Simulation) -> list[str]:
    """Drive a few scenarios and return warnings about the ADS.

    Returns:
        A sentence for each finding: the ADS fails, always gives the same answer, never moves, was trained with masks of
        actions, or on a different kind of observations. The last happens when its `VecNormalize` statistics are
        missing. In a highway-env environment, also that its configuration is not known, that it is not compiled, or
        that its draws do not determine its episodes.
    """
    witness = _Witness(simulation.ads)
    generator = np.random.default_rng(0)
    scenarios = [simulation.logical.sample(generator) for _ in range(SCENARIOS)]
    try:
        traces = _traces(simulation, witness, scenarios)
    except ADSError as error:
        return [f"In the first scenarios, {error}"]
    prepare = getattr(simulation.ads, "prepare", lambda observation: observation)
    seen = joined([prepare(observation) for observation in witness.observations])
    trained_on = getattr(simulation.ads, "last_trained_on", None)
    findings = (
        _unconfigured(simulation),
        _uncompiled(simulation),
        _unrepeatable(simulation, scenarios[0]),
        _unmasked(simulation.ads),
        _constant(witness.actions),
        _motionless(traces),
        _foreign(seen, trained_on),
    )
    return [finding for finding in findings if finding]


def _traces(simulation: Simulation, witness: _Witness, scenarios: list[Scenario]) -> list[Trace]:
    """Drive scenarios in the compiled form of the environment where there is one, together if the ADS allows that."""
    envs = simulation.compiled(len(scenarios))
    if envs is None:
        return [rollout(simulation.env, witness, scenario) for scenario in scenarios]
    return [trace for _, trace in rollout_all(envs, witness, scenarios)]


def _unconfigured(simulation: Simulation) -> str | None:
    if simulation.is_configured:
        return None
    return (
        f"The configuration in which the policy was trained is not known, so highway-env's own is used, and rates "
        f"depend on it: give it {_WHERE_CONFIGURED[simulation.source]}"
    )


def _uncompiled(simulation: Simulation) -> str | None:
    if not simulation.plain:
        return None
    reason = simulation.plain.partition("; use gymnasium")[0]  # which those who make vector environments are told
    if simulation.logical.has_original:
        return f"highway-env itself executes the scenarios, hundreds of times as slow as compiled: {reason}"
    return f"One scenario is executed at a time, many times as slow as compiled: {reason}"


def _unrepeatable(simulation: Simulation, scenario: Scenario) -> str | None:
    """Return a warning if the draws of a highway-env environment do not determine how its episodes begin."""
    if not simulation.logical.has_original:
        return None
    env: Any = simulation.env
    starts = set()
    for _ in range(2):
        observation, _ = env.reset(options={"scenario": scenario})
        seen = [array.tobytes() for array in arrays_of(mapped(np.asarray, observation))]
        starts.add((repr(env.record.frames[0].things.tolist()), env.road_shape().to_json(), *seen))
    if len(starts) == 1:
        return None
    return (
        "The environment begins the same scenario in another way when it is repeated, so failures can be neither "
        "confirmed nor replayed: it must draw by its attribute np_random alone"
    )


def _unmasked(ads: Any) -> str | None:
    if not getattr(ads, "was_masked", False):
        return None
    return (
        "The policy was trained with masks of actions, which it is not given here: it may choose actions that the "
        "masks ruled out"
    )


def _constant(actions: list[NDArray[Any]]) -> str | None:
    stacked = np.concatenate(actions)
    if (stacked != stacked[0]).any():
        return None
    return f"The ADS is constant: all its {len(stacked)} decisions in {SCENARIOS} scenarios were {stacked[0]}"


def _motionless(traces: list[Trace]) -> str | None:
    if max(np.hypot(*trace.velocity[:, 0].T).max() for trace in traces) >= STANDING_SPEED:
        return None
    return f"The ego never moved in {SCENARIOS} scenarios"


def _foreign(seen: Observation, trained_on: Observation | None) -> str | None:
    """Return a warning if the policy's last training observations lie outside the range observed here.

    Args:
        seen: observations made here, shape (n, ...).
        trained_on: last training observations, shape (m, ...), with or without frames stacked along the last axis;
            None if unknown.
    """
    values = _values_outside(seen, trained_on)
    share = float(np.mean(np.concatenate(values))) if values else 0.0
    if share <= FOREIGN:
        return None
    return (
        f"{share:.0%} of the values that the policy was last trained on lie outside the range that it observes here: "
        f"are the statistics of VecNormalize missing, or was it trained on different observations?"
    )


def _values_outside(seen: Observation, trained_on: Observation | None) -> list[NDArray[np.bool_]]:
    """Return which values of the training lie outside the range observed here, where the observations are alike."""
    if isinstance(seen, Mapping) and isinstance(trained_on, Mapping):
        common = sorted(seen.keys() & trained_on.keys())
        return [values for key in common for values in _values_outside(seen[key], trained_on[key])]
    if trained_on is None or isinstance(seen, Mapping) or isinstance(trained_on, Mapping):
        return []
    if trained_on.shape[1:-1] != seen.shape[1:-1]:
        return []
    last = trained_on[..., -seen.shape[-1] :]
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = MARGIN * (high - low) + 1e-3
    return [((last < low - margin) | (last > high + margin)).ravel()]
