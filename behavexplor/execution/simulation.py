"""Simulations: one ADS in one environment, which turn concrete scenarios into traces.

Also what is known of an environment without a scenario: its kernels, logical scenario and default search method.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from numbers import Real
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv

import behavexplor
from behavexplor.ads.loading import load_ads
from behavexplor.ads.sb3.description import is_policy
from behavexplor.ads.sb3.highway_fit import how_to_fit
from behavexplor.data.drawn_logical import DrawnLogicalScenario
from behavexplor.data.drawn_scenario import DECLARED, DEFAULT, Traffic
from behavexplor.data.named_code import TRAFFIC_CLASS, traffic_code
from behavexplor.data.scenario import LogicalScenario, Scenario
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.data.target import Activation
from behavexplor.data.trace import Trace
from behavexplor.envs.logical_scenarios import LOGICAL_SCENARIOS
from behavexplor.envs.making import (
    check_keys,
    default_config,
    environment_id,
    has_own_config,
    is_highway,
    make_env,
    make_registered,
    make_vector_env,
)
from behavexplor.errors import InputError, brief, described, place_of
from behavexplor.execution.rollout import DrawnActions, LockStep, rollout, rollout_all, run_episodes

FILE, MODULE, MEMORY = "file", "module", "memory"  # where the ADS of a simulation comes from
_MISSING: Final = object()
_METHOD: Final = (Callable, "a method")
_NUMBER: Final = (Real, "a number")
# attributes that a driver can have, by name: the type that each must be of, and that type in words
_ATTRIBUTES: Final[Mapping[str, tuple[Any, str]]] = {
    "observation": (Mapping, "a mapping, such as {'type': 'Kinematics'}"),
    "action": (Mapping, "a mapping, such as {'type': 'DiscreteMetaAction'}"),
    "policy_frequency": _NUMBER,
    "simulation_frequency": _NUMBER,
    "env_config": (Mapping, "a mapping, such as {'lanes_count': 3}"),
    "fitted": _METHOD,
    "seeing": _METHOD,
    "noise": _NUMBER,
    **dict.fromkeys(("observation_space", "action_space", "vectorized", "log"), (object, "anything")),
}
_KERNELS_OF_VIEWS: Final = ({"observation": {"type": "Kinematics"}}, {"action": {"type": "DiscreteMetaAction"}})


class Simulation:
    """Runs concrete scenarios with one ADS in one environment.

    Args:
        env: name of the environment, see `behavexplor.envs.making`. The environment takes
            `reset(options={"scenario": ...})`, declares the scenarios that it can run in its attribute `logical`, and
            ends an episode with `info["trace"]`.
        ads: name of the driving system, see `behavexplor.ads.loading.load_ads`. Its attributes `observation`, `action`,
            `policy_frequency` and `simulation_frequency`, where it has them, configure the environment. In an
            environment of highway-env, so does its attribute `env_config`, or its method `fitted`, which makes a
            configuration in which it drives from the environment's own. Its method `seeing`, if it has one, returns the
            driver for the environment's spaces of observations and actions.
        trust: digests of files from which code may be run when the ADS is loaded.
        env_config: configuration of the environment, which replaces what the ADS declares; None if it is not known.
        traffic: kind of traffic in a highway-env environment; see `behavexplor.data.drawn_scenario.Setup`.
        stochastic: whether the ADS draws its actions instead of deciding deterministically.
        render_mode: what the environment's `render` returns or shows, as in gymnasium.
        activation: function between the layers of a file of weights; None for that in the file beside it.

    Attributes:
        env, ads: the environment and the ADS, made to fit each other.
        source: where the ADS comes from: `FILE`, `MODULE` or `MEMORY`.
        logical: the logical scenario that the environment declares.
        plain: why the environment cannot run in lock-step, once this is known; empty if it can.
        stochastic: whether the ADS draws its actions.
        is_configured: whether a configuration for the policy was found, where one is needed.

    Raises:
        InputError: if there is no such environment or ADS, or if they do not fit together.
    """

    def __init__(
        self,
        env: str,
        ads: Any,
        trust: Collection[str] = (),
        env_config: Mapping[str, Any] | None = None,
        traffic: Traffic = DEFAULT,
        *,
        stochastic: bool = False,
        render_mode: str | None = None,
        activation: Activation | None = None,
    ) -> None:
        in_highway_env = is_highway(env)
        roadmap = None if in_highway_env else logical_scenario(env).roadmap
        self.source = _source(ads)
        self.ads: Any = load_ads(ads, roadmap, trust, activation) if isinstance(ads, str) else ads
        _check_attributes(self.ads)
        declared = {key: _plain(getattr(self.ads, key)) for key in DECLARED if hasattr(self.ads, key)}
        trained = _plain(getattr(self.ads, "env_config", {})) if in_highway_env else {}
        given = dict(env_config or {})
        _check_traffic(ads, trained, given)
        if in_highway_env:  # a model in memory drives with the keys with which it was trained
            kept = () if isinstance(ads, str) else trained.keys() - given.keys()
            whole = {**declared, **trained, **given}
            ignored = check_keys(env, {key: value for key, value in whole.items() if key not in kept})
            trained = {key: value for key, value in trained.items() if key not in ignored}
            given = {key: value for key, value in given.items() if key not in ignored}
        if in_highway_env and hasattr(self.ads, "fitted"):
            given = _answer(self.ads, "fitted", {**default_config(env), **given}, needed="keys")  # a mapping
        self.env = make_env(env, {**declared, **trained, **given}, traffic, render_mode)
        if hasattr(self.ads, "seeing"):
            self.ads = _answer(self.ads, "seeing", self.env.observation_space, self.env.action_space, needed="predict")
        self.logical = logical_of(self.env, env)
        self.plain = ""
        self.stochastic = stochastic
        self._single: LockStep | None = None  # one episode at a time; made by the first run
        if stochastic and not getattr(self.ads, "noise", 0):
            raise InputError(f"The driver {brief(ads)} cannot draw its actions: leave out --stochastic")
        is_asked = in_highway_env and hasattr(self.ads, "observation_space") and not hasattr(self.ads, "env_config")
        self.is_configured = not is_asked or env_config is not None or has_own_config(env)
        _check_spaces(self.env, environment_id(env), self.ads, ads)

    def run(self, scenario: Scenario) -> Trace:
        """Run a scenario to its end, and return its trace.

        Scripted vehicles are simulated in a compiled environment with one slot, if it supports the configuration, and
        highway-env's environments as they are.
        """
        if not self.logical.has_original and self._single is None:  # with scripted vehicles
            self._single = self.lock_step(1)
        if self._single is None:
            return rollout(self.env, self.driver(1), scenario)
        self._single.give_up()  # drops an episode that is left over after a failure of the driver
        [(_, trace)] = run_episodes(self._single, [scenario])
        return trace

    def run_compiled(self, scenario: Scenario) -> Trace:
        """Run a scenario as a campaign does, and return its trace: compiled, unless the engine cannot begin it.

        Raises:
            ADSError: if the ADS fails.
        """
        if not self.logical.has_original:
            return self.run(scenario)
        try:
            ((_, trace),) = self.run_all([scenario])
        except InputError:  # the engine cannot begin it
            return self.run(scenario)
        return trace

    def run_all(self, scenarios: Sequence[Scenario], batch: int = 64) -> Iterator[tuple[int, Trace]]:
        """Run scenarios to their ends, `batch` at a time in lock-step if the ADS and the vector environment support it.

        Yield the index of a scenario, counted from 0, and its trace, in the order in which the episodes end.
        """
        envs = self.compiled(min(batch, len(scenarios)))
        if envs is None:
            yield from enumerate(map(self.run, scenarios))
            return
        yield from rollout_all(envs, self.driver(envs.num_envs), scenarios)
        envs.close()

    def lock_step(self, count: int, *, short: bool = False) -> LockStep | None:
        """Return episodes in lock-step; None if the environment has no compiled form.

        `count` is the number of episodes at a time, 1 if the ADS takes one observation at a time. With `short`, the
        flag `short_traces` of the vector environment is set, and the ADS's log is not recorded; the result is None if
        the vector environment has no such flag.
        """
        envs: Any = self.compiled(count)
        if envs is None or (short and not hasattr(envs, "short_traces")):
            return None
        envs.short_traces = short
        if hasattr(envs, "checks_actions"):
            envs.checks_actions = False  # what an ADS answers is checked when it is asked
        return LockStep(envs, self.driver(envs.num_envs), logs=not short)

    def driver(self, count: int, ads: Any = None) -> Any:
        """Return what drives a number of episodes in lock-step: the ADS, or another one in its place."""
        ads = ads or self.ads
        return DrawnActions(ads, count) if self.stochastic else ads

    def close(self) -> None:
        """Release the resources of the environment."""
        self.env.close()

    def compiled(self, count: int) -> VectorEnv[Any, Any, Any] | None:
        """Return a vector environment for episodes in lock-step; see `lock_step`."""
        count = count if getattr(self.ads, "vectorized", False) else 1
        return self.vector_env(count)

    def vector_env(self, count: int, **changes: Any) -> VectorEnv[Any, Any, Any] | None:
        """Return a vector environment with the observations and actions of the ADS.

        It is None if the environment has none, or none that supports this configuration. `count` is the number of
        episodes at a time. `changes` are keys of the environment's configuration that replace those of the ADS.
        """
        try:
            return make_vector_env(self.env, count, changes)
        except InputError as error:
            self.plain = str(error)
            return None


def _check_attributes(ads: Any) -> None:
    """Refuse a driver with an attribute of the wrong type, or with one that raises an error when it is read."""
    for name, (wanted, words) in _ATTRIBUTES.items():
        try:
            value = getattr(ads, name, _MISSING)
        except Exception as error:  # a property can raise anything
            raise InputError(f"The driver's {name} cannot be looked at: {described(error)}{place_of(error)}") from error
        if value is not _MISSING and not isinstance(value, wanted):
            raise InputError(f"The driver's {name} must be {words}, got {brief(value)}")


def _answer(ads: Any, method: str, *arguments: Any, needed: str) -> Any:
    """Return what a method of a driver returns. It must have the attribute that is needed."""
    try:
        found = getattr(ads, method)(*arguments)
    except InputError:
        raise
    except Exception as error:  # its code can raise anything
        raise InputError(f"The driver's {method} failed: {described(error)}{place_of(error)}") from error
    if not hasattr(found, needed):
        raise InputError(f"The driver's {method} must return what has {needed}, got {brief(found)}")
    return found


def _check_traffic(ads: Any, trained: Mapping[str, Any], given: Mapping[str, Any]) -> None:
    """Refuse a class of vehicles that the files beside a policy name and the given configuration does not replace."""
    named = traffic_code(trained)
    if named and _source(ads) == FILE and TRAFFIC_CLASS not in given:
        raise InputError(
            f"The files beside {ads} name the class {named[0].name} for the traffic, which was not loaded: give the "
            f"configuration by --env-config FILE (in Python, env_config) if it shall drive"
        )


def _source(ads: Any) -> str:
    if not isinstance(ads, str):
        return MEMORY
    return FILE if is_policy(ads) else MODULE


def _plain(value: Any) -> Any:
    """Return a mapping as a dictionary, which can be copied, and any other value as it is."""
    return dict(value) if isinstance(value, Mapping) else value


def _check_spaces(env: gymnasium.Env[Any, Any], name: str, ads: Any, ads_name: Any) -> None:
    """Refuse a policy with declared spaces that cannot drive in an environment, and say how to make it fit."""
    if not (hasattr(ads, "observation_space") and hasattr(ads, "action_space")):
        return
    if _fits(ads, env):
        return
    spaces = (ads.observation_space, ads.action_space)
    named = f"policy {ads_name!r}" if isinstance(ads_name, str) else "policy in memory"
    raise InputError(
        f"The {named} observes {brief_space(spaces[0])} and commands {brief_space(spaces[1])}, but the environment "
        f"{name!r} has {brief_space(env.observation_space)} and {brief_space(env.action_space)}. "
        f"{_where_it_fits(ads)}{how_to_fit(*spaces)}"
    )


def _where_it_fits(ads: Any) -> str:
    """Return a sentence on which environments of this package have a policy's spaces; empty if none has."""
    fitting = []
    for other in (*behavexplor.FUNCTIONAL_SCENARIOS, *behavexplor.HIGHWAY_ENV):
        made = make_env(other, {})
        if _fits(ads, made):
            fitting.append(other)
        made.close()
    return (
        f"It fits {', '.join(fitting)} without a configuration: should --env name one of these? Otherwise: "
        if fitting
        else ""
    )


def seen_in(env: str, ads: Any, config: Mapping[str, Any]) -> tuple[Any, bool]:
    """Return a driver as it sees an environment, and whether it fits its spaces.

    The configuration is that of the environment, and replaces what the driver declares.

    Raises:
        InputError: if the environment cannot be configured so, or the driver cannot see it.
    """
    declared = {key: _plain(getattr(ads, key)) for key in DECLARED if hasattr(ads, key)}
    made = make_registered(env, {**declared, **getattr(ads, "env_config", {}), **config})
    made.close()
    seen = ads.seeing(made.observation_space, made.action_space) if hasattr(ads, "seeing") else ads
    return seen, _fits(seen, made)


def _fits(ads: Any, env: gymnasium.Env[Any, Any]) -> bool:
    return _alike(ads.observation_space, env.observation_space) and _alike(ads.action_space, env.action_space)


def _alike(policy: gymnasium.Space[Any], env: gymnasium.Space[Any]) -> bool:
    """Return whether values of both spaces have the same form."""
    if isinstance(policy, gymnasium.spaces.Discrete) and isinstance(env, gymnasium.spaces.Discrete):
        return bool(policy.n == env.n)
    if isinstance(policy, gymnasium.spaces.Dict) and isinstance(env, gymnasium.spaces.Dict):
        return policy.keys() == env.keys() and all(_alike(policy[key], env[key]) for key in policy)
    return type(policy) is type(env) and policy.shape == env.shape


def brief_space(space: gymnasium.Space[Any]) -> str:
    """Return a space for a message, such as Box(5, 5)."""
    if isinstance(space, gymnasium.spaces.Dict):
        return f"Dict({', '.join(f'{key}: {brief_space(part)}' for key, part in sorted(space.items()))})"
    return f"Box{space.shape}" if isinstance(space, gymnasium.spaces.Box) else str(space)


def compile_kernels(env: str) -> None:
    """Compile the kernels that execute an environment, for one scenario at a time and for many in lock-step.

    All environments of highway-env share one engine. An environment of another package has no kernels: it is only made.
    """
    with_scripted_vehicles = {environment_id(name) for name in behavexplor.FUNCTIONAL_SCENARIOS}
    if environment_id(env) not in with_scripted_vehicles:
        _compile_by_making(env)
        return
    simulation = Simulation(env, "constant")
    scenario = simulation.logical.sample(np.random.default_rng(0))
    simulation.run(scenario)
    for _ in simulation.run_all([scenario, scenario], 2):
        pass
    for changes in _KERNELS_OF_VIEWS:
        envs = simulation.vector_env(2, **changes)
        if envs is not None:
            envs.reset(seed=0)
            envs.step(envs.action_space.sample())
            envs.close()
    simulation.close()


def _compile_by_making(env: str) -> None:
    """Make an environment and its vector environment, which compiles the engine that all of highway-env's share."""
    made = make_env(env, {})
    try:
        envs = make_vector_env(made, 1, {})
    except InputError:  # highway-env itself will execute the scenarios
        return
    finally:
        made.close()
    if envs is not None:
        envs.close()


def logical_scenario(env: str) -> LogicalScenario:
    """Return the logical scenario of an environment in its own configuration.

    Raises:
        InputError: if there is no such environment, or if it has no logical scenario.
    """
    if env in LOGICAL_SCENARIOS:
        return LOGICAL_SCENARIOS[env]
    made = make_env(env, {})
    made.close()
    return logical_of(made, env)


def default_method(env: str) -> str:
    """Return the search method that is used in an environment if none is chosen.

    In highway-env's environments, no guided method of this package finds more classes of failures than uniform draws
    (docs/results.md), and the share of failures among uniform draws is the policy's own rate.
    """
    return "uniform" if is_highway(env) else "behavexplor"


def fixed_logical_scenario(env: str) -> LogicalScenario | None:
    """Return the logical scenario of an environment; None if it depends on what the driver declares."""
    return None if is_highway(env) else logical_scenario(env)


def logical_of(made: gymnasium.Env[Any, Any], name: str) -> LogicalScenario:
    """Return the logical scenario that an environment declares.

    Raises:
        InputError: if it declares none.
    """
    logical = getattr(made.unwrapped, "logical", None)
    if not isinstance(logical, ScriptedLogicalScenario | DrawnLogicalScenario):
        raise InputError(
            f"The environment {name!r} cannot be fuzzed: it is not one of highway-env, and it has no attribute "
            f"`logical` that declares its scenarios (a behavexplor.data.scripted_logical.ScriptedLogicalScenario)"
        )
    return logical
