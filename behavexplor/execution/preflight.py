"""Preflight: check a system under test before a campaign, so that mistakes in its setup show early."""

from collections.abc import Mapping
from contextlib import suppress
from itertools import chain, repeat
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.conventions import STANDING_SPEED
from behavexplor.data.observations import Observation, arrays_of, joined, mapped
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.executor import ADSError
from behavexplor.execution.rollout import is_function, rollout, rollout_all
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
_SO_NOT_REPLAYED: Final = (
    "so failures can be neither confirmed nor replayed: it must draw by its attribute np_random alone"
)
_WITH_DRAWS: Final = "; with --stochastic (in Python, stochastic=True) it would draw its actions, as in training"


class _Witness:
    """An ADS that also records its observations and actions, except those of absent egos, whose rows are zeros."""

    def __init__(self, ads: Any) -> None:
        self.ads = ads
        self.is_function = is_function(ads)
        self.noise = getattr(ads, "noise", 0)
        self.observations: list[Observation] = []
        self.actions: list[NDArray[Any]] = []

    def predict(self, observation: Observation, *arguments: Any, **keywords: Any) -> Any:
        return self._noted(observation, self.ads.predict(observation, *arguments, **keywords))

    def draw(self, observation: Observation, *arguments: Any) -> Any:
        return self._noted(observation, self.ads.draw(observation, *arguments))

    def _noted(self, observation: Observation, answer: Any) -> Any:
        is_there = _rows_with_values(observation)
        self.observations.append(mapped(lambda array: np.array(array)[is_there], observation))
        with suppress(TypeError, LookupError, ValueError):  # no pair, or of another shape: `ask` says what is wrong
            self.actions.append(np.array(answer[0])[is_there])
        return answer


class _Playback:
    """An ADS that repeats recorded actions, one after the other, and then the last one."""

    def __init__(self, actions: list[NDArray[Any]]) -> None:
        self.noise = 0
        self._actions = chain(actions, repeat(actions[-1]))

    def predict(self, *_: Any, **__: Any) -> tuple[NDArray[Any], None]:
        return next(self._actions), None

    def draw(self, *_: Any) -> tuple[NDArray[Any], None]:
        return self.predict()


def _rows_with_values(observation: Observation) -> NDArray[np.bool_]:
    """Return which rows of an observation have any value but 0, shape (B,); all, if none has."""
    found = np.any([array.reshape(len(array), -1).any(axis=1) for array in arrays_of(observation)], axis=0)
    return np.asarray(found | ~found.any())


def preflight_warnings(simulation: Simulation) -> list[str]:
    """Drive a few scenarios and return warnings about the ADS, a sentence for each finding.

    They are on the ADS: that it fails, never moves, always gives the same answer, sees or acts through wrappers, or was
    trained with masks of actions, or on other observations, because its `VecNormalize` statistics are missing. Or they
    are on the environment: that its configuration is not known, that it is not compiled, or that a scenario does not
    repeat, alone or beside others.
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
        getattr(simulation.ads, "said", None),  # what wrappers do to its observations and actions
        _unconfigured(simulation),
        _uncompiled(simulation),
        _unrepeatable(simulation, scenarios[0], traces[0]),
        _unmasked(simulation.ads),
        _constant(simulation, witness.actions),
        _motionless(traces),
        _foreign(seen, trained_on),
    )
    return [finding for finding in findings if finding]


def _traces(simulation: Simulation, ads: Any, scenarios: list[Scenario]) -> list[Trace]:
    """Drive scenarios, in the compiled environment if there is one, and return their traces in the same order.

    The ADS drives them together if it allows that.
    """
    envs = simulation.compiled(len(scenarios))
    if envs is None:
        return [rollout(simulation.env, simulation.driver(1, ads), scenario) for scenario in scenarios]
    return [trace for _, trace in sorted(rollout_all(envs, simulation.driver(envs.num_envs, ads), scenarios))]


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


def _unrepeatable(simulation: Simulation, scenario: Scenario, together: Trace) -> str | None:
    """Return a warning if a scenario does not determine its episode: because of the environment, or of the ADS.

    `together` is the trace of the episode that was driven in lock-step with others.
    """
    if simulation.logical.has_original and not _begins_alike(simulation.env, scenario):
        return f"The environment begins the same scenario in another way when it is repeated, {_SO_NOT_REPLAYED}"
    witness = _Witness(simulation.ads)
    (first,) = _traces(simulation, witness, [scenario])
    actions = list(witness.actions)
    (second,) = _traces(simulation, witness, [scenario])
    if first.to_bytes() == second.to_bytes() == together.to_bytes():
        return None
    if first.to_bytes() == second.to_bytes():
        return (
            "The driver drives a scenario otherwise when it drives others at the same time, so its failures cannot be "
            "replayed: decide each row from its own observation and state, or leave out `vectorized`"
        )
    (again,) = _traces(simulation, _Playback(actions), [scenario])
    if not np.array_equal(again.position, first.position):
        return f"The environment goes on in another way when a scenario is repeated, {_SO_NOT_REPLAYED}"
    return (
        "The driver does not drive the same scenario in the same way when it is repeated, as if it drew its actions or "
        "remembered earlier episodes, so its failures cannot be replayed: see docs/policies.md for drawn actions"
    )


def _begins_alike(env: Any, scenario: Scenario) -> bool:
    """Return whether the draws of a highway-env environment determine how its episodes begin."""
    starts = set()
    for _ in range(2):
        observation, _ = env.reset(options={"scenario": scenario})
        seen = [array.tobytes() for array in arrays_of(mapped(np.asarray, observation))]
        starts.add((repr(env.record.frames[0].things.tolist()), env.road_shape().to_json(), *seen))
    return len(starts) == 1


def _unmasked(ads: Any) -> str | None:
    if not getattr(ads, "was_masked", False):
        return None
    return (
        "The policy was trained with masks of actions, which it is not given here: it may choose actions that the "
        "masks ruled out"
    )


def _constant(simulation: Simulation, actions: list[NDArray[Any]]) -> str | None:
    stacked = np.concatenate(actions)
    if (stacked != stacked[0]).any():
        return None
    draws_when_trained = getattr(simulation.ads, "noise", 0) and not simulation.stochastic
    advice = _WITH_DRAWS if draws_when_trained else ""
    choice = _named_action(simulation, stacked[0])
    return f"The driver always chooses {choice} ({len(stacked)} decisions in {SCENARIOS} scenarios){advice}"


def _named_action(simulation: Simulation, action: Any) -> Any:
    """Return the name of a discrete action of highway-env, such as "FASTER"; any other action as it is."""
    env = getattr(simulation.env.unwrapped, "inner", simulation.env.unwrapped)
    names = getattr(getattr(env, "action_type", None), "actions", None)
    return names[int(action)] if isinstance(names, Mapping) and action.ndim == 0 else action


def _motionless(traces: list[Trace]) -> str | None:
    if max(np.hypot(*trace.velocity[:, 0].T).max() for trace in traces) >= STANDING_SPEED:
        return None
    return f"The ego never moved in {SCENARIOS} scenarios"


def _foreign(seen: Observation, trained_on: Observation | None) -> str | None:
    """Return a warning if the policy's last training observations lie outside the range observed here.

    `seen` has shape (n, ...). `trained_on`, shape (m, ...), may have frames stacked along its last axis; it is None if
    it is not known.
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
