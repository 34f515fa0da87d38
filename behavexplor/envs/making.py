"""Make environments by name: those with scripted vehicles, and highway-env's own ones, whose draws are the scenario."""

import importlib
import json
import re
import sys
import warnings
from collections.abc import Mapping
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from functools import cache
from importlib.metadata import entry_points
from typing import Any, Final

import gymnasium
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, VectorEnv

import behavexplor
from behavexplor.data.drawn_scenario import DEFAULT, Setup, Traffic
from behavexplor.data.named_code import env_code, traffic_code
from behavexplor.data.target import PAPERS_NAMES
from behavexplor.envs.values import POSITIVE
from behavexplor.errors import InputError, ignored_key, unknown_name

ENTRY_POINTS: Final = "behavexplor.environments"  # group of entry points: a module by the namespace of its environments
HIGHWAY_ENV: Final = "highway_env"  # importing this package registers its environments, and is slow


def environment_id(name: str) -> str:
    """Return the gymnasium id of an environment.

    Args:
        name: name of a functional scenario, such as "intersection-straight", or the paper's name of it ("S1" to "S4");
            or a full gymnasium id, such as "highway-fast-v0". For an environment that another module registers, write
            "module:id". The id suffices if its package declares the module as an entry point of the group
            `ENTRY_POINTS`.

    Raises:
        InputError: if there is no such environment. Names of other modules and namespaces are not checked.
    """
    name = PAPERS_NAMES.get(name, name)
    if name in behavexplor.FUNCTIONAL_SCENARIOS:
        return f"{behavexplor.NAMESPACE}/{name}-v0"
    if ":" in name or name in gymnasium.registry:
        return name
    if "/" in name:
        _import_plugin(name.partition("/")[0])
        return name
    importlib.import_module(HIGHWAY_ENV)  # registers its environments
    if name not in gymnasium.registry:
        own = [known for known in behavexplor.FUNCTIONAL_SCENARIOS if known.startswith(name)]
        raise unknown_name(
            "environment", name, own or [*behavexplor.FUNCTIONAL_SCENARIOS, *PAPERS_NAMES, *highway_ids()]
        )
    return name


def highway_ids() -> list[str]:
    """Return the ids of highway-env's own environments."""
    importlib.import_module(HIGHWAY_ENV)
    theirs = [name for name, spec in gymnasium.registry.items() if str(spec.entry_point).startswith(HIGHWAY_ENV)]
    return [name for name in theirs if "/" not in name]  # not this package's, such as behavexplor/highway-v0


def _import_plugin(namespace: str) -> None:
    """Import the module that registers the environments of a namespace, if an installed package declares it."""
    for entry in entry_points(group=ENTRY_POINTS, name=namespace):
        importlib.import_module(entry.module)


@cache
def is_highway(name: str) -> bool:
    """Return whether an environment is one of highway-env, or a subclass, without scripted vehicles.

    Raises:
        InputError: if there is no such environment.
    """
    if name in behavexplor.FUNCTIONAL_SCENARIOS:
        return False
    made = make_registered(name, {})
    made.close()
    return _is_highway(made)


def check_keys(name: str, config: Mapping[str, Any]) -> frozenset[str]:
    """Check a configuration of highway-env, warn of each key that the environment ignores, and return these keys.

    Raises:
        InputError: if a key inside the observation or the action is unknown, or a number is given as a text.
    """
    from behavexplor.envs.env_config import check_space_keys  # noqa: PLC0415 - slow to import

    with closing(make_registered(name, {})) as env:
        made: Any = env.unwrapped
    check_space_keys(made, config)
    for key, value in config.items():
        default = made.config.get(key)
        if isinstance(value, str) and isinstance(default, int | float) and not isinstance(default, bool):
            is_exponent = re.fullmatch(r"[-+]?[\d.]+[eE][-+]?\d+", value)
            hint = " (in YAML, an exponent needs a sign, and a point before it: 1.0e+5)" if is_exponent else ""
            raise InputError(f"{key} of {name}: expected a number, got {value!r:.80}{hint}")
    ignored = frozenset(map(str, config.keys() - made.config.keys()))
    for key in sorted(ignored):
        warnings.warn(ignored_key(name, key, made.config), stacklevel=2)
    return ignored


def default_config(name: str) -> dict[str, Any]:
    """Return the whole configuration of an environment as it is registered; empty if it has none."""
    with closing(make_registered(name, {})) as made:
        config: dict[str, Any] = getattr(made.unwrapped, "config", {})
    return config


@cache
def has_own_config(name: str) -> bool:
    """Return whether a subclass or the registration of an environment of highway-env states a configuration of its own.

    Raises:
        InputError: if there is no such environment.
    """
    made: Any = make_registered(name, {})
    made.close()
    stated = type(made.unwrapped).default_config.__module__
    return bool(made.spec.kwargs.get("config")) or not stated.startswith(f"{HIGHWAY_ENV}.")


def make_env(
    name: str, config: Mapping[str, Any], traffic: Traffic = DEFAULT, render_mode: str | None = None
) -> gymnasium.Env[Any, Any]:
    """Make an environment that runs concrete scenarios.

    The environment takes `reset(options={"scenario": ...})`, and ends an episode with `info["trace"]`.

    Args:
        name: name of the environment, see `environment_id`.
        config: configuration of the environment, as far as it differs from its own.
        traffic: kind of traffic in a highway-env environment; see `behavexplor.data.drawn_scenario.Setup`.
        render_mode: what `render` returns or shows, as in gymnasium.

    Raises:
        InputError: if there is no such environment, it cannot be configured, or one driver cannot drive in it.
    """
    made = make_registered(name, config, render_mode)
    if not _is_highway(made):
        return made
    _check_ego(name, made)
    _check_times(made)
    from behavexplor.envs.highway.drawn_env import DrawnEnv  # noqa: PLC0415 - slow to import

    return DrawnEnv(name, made, traffic)


def drawn(
    env: str = "highway-fast-v0",
    config: Mapping[str, Any] | None = None,
    traffic: Traffic = DEFAULT,
    render_mode: str | None = None,
) -> gymnasium.Env[Any, Any]:
    """Make `behavexplor/drawn-v0`: an environment of highway-env that takes `reset(options={"scenario": ...})`."""
    return make_env(env, config or {}, traffic, render_mode)


def make_recorded(setup: Setup) -> Any:
    """Make the highway-env environment of a recorded scenario, as `make_env` does.

    A record may come from anyone and brings no code: what it names must be highway-env's, this package's or loaded.

    Raises:
        InputError: if it names anything else, or the environment cannot be made.
    """
    config = json.loads(setup.config)
    for code in (*env_code(setup.env), *traffic_code(config)):
        if not (code.module in sys.modules or code.name in gymnasium.registry):
            raise InputError(f"The recorded scenario names {code}, which its run does not use, so it was not loaded")
    return make_env(setup.env, config, setup.traffic)


def _check_ego(name: str, env: gymnasium.Env[Any, Any]) -> None:
    """Refuse an environment without exactly one ego, or with tuples for several egos, since a driver drives one."""
    made: Any = env.unwrapped
    count = len(made.controlled_vehicles)
    if count != 1:
        raise InputError(
            f"{name} has {count} controlled vehicles, and a driver drives one: set `controlled_vehicles` of its "
            f"configuration to 1"
        )
    for kind, space in (("observation", env.observation_space), ("action", env.action_space)):
        if isinstance(space, gymnasium.spaces.Tuple):
            raise InputError(f"{name} has tuples as {kind}s, which no driver takes: configure another `{kind}` of it")


def _check_times(env: gymnasium.Env[Any, Any]) -> None:
    """Refuse times with which highway-env would divide by zero, or would never move its vehicles."""
    made: Any = env.unwrapped
    config = made.config
    for key in ("policy_frequency", "simulation_frequency", "duration"):
        if key in config:
            POSITIVE.check(key, config[key])
    decisions, frames = config["policy_frequency"], config["simulation_frequency"]
    if decisions > frames:
        raise InputError(f"policy_frequency {decisions} must not exceed simulation_frequency {frames}")


def make_vector_env(
    env: gymnasium.Env[Any, Any], num_envs: int, changes: Mapping[str, Any], *, rewards: bool = False
) -> VectorEnv[Any, Any, Any] | None:
    """Make the vector form of an environment that `make_env` made, with autoreset disabled; None if it has none.

    `changes` replace keys of the configuration. The vector form of an environment of highway-env begins its episodes in
    `env`, so it allows no changes: with any, None is returned. Without `rewards`, a compiled environment computes none,
    and is faster.

    Raises:
        InputError: if the vector form does not support the configuration.
    """
    if _is_highway(env):
        from behavexplor.envs.highway.drawn_vector_env import DrawnVectorEnv  # noqa: PLC0415 - slow to import

        drawn_env: Any = env
        return None if changes else DrawnVectorEnv(drawn_env, num_envs, rewards=rewards)
    spec = env.spec
    if spec is None or spec.vector_entry_point is None:
        return None
    made = gymnasium.make_vec(
        spec.id,
        num_envs=num_envs,
        vectorization_mode="vector_entry_point",
        autoreset_mode=AutoresetMode.DISABLED,
        config={**spec.kwargs.get("config", {}), **changes},
    )
    if hasattr(made, "gives_rewards"):
        made.gives_rewards = rewards
    return made


def _with_tuples(value: Any) -> Any:
    """Return a configuration whose image shapes are tuples, as highway-env wants them; YAML and JSON have lists."""
    if isinstance(value, list | tuple):
        return type(value)(map(_with_tuples, value))
    if not isinstance(value, Mapping):
        return value
    return {
        key: tuple(part) if key == "observation_shape" and isinstance(part, list) else _with_tuples(part)
        for key, part in value.items()
    }


def _kept_classes(spec: EnvSpec) -> AbstractContextManager[None]:
    """Return a context in which an environment of highway-env may be made without an effect on others."""
    if str(spec.entry_point).startswith("behavexplor."):
        return nullcontext()
    from behavexplor.envs.engine.vehicle_parameters import VehicleClasses  # noqa: PLC0415 - slow to import

    return VehicleClasses().applied()


def _is_highway(made: gymnasium.Env[Any, Any]) -> bool:
    """Return whether an environment is one of highway-env. One with a `logical` scenario has scripted vehicles."""
    from highway_env.envs.common.abstract import AbstractEnv  # noqa: PLC0415 - slow to import

    inner = getattr(made.unwrapped, "inner", made.unwrapped)
    return isinstance(inner, AbstractEnv) and not hasattr(inner, "logical")


def make_registered(name: str, config: Mapping[str, Any], render_mode: str | None = None) -> gymnasium.Env[Any, Any]:
    """Make an environment as gymnasium does.

    Raises:
        InputError: if there is no such environment, or it cannot be configured.
    """
    module, _, own = environment_id(name).rpartition(":")
    try:
        if module:
            importlib.import_module(module)
        spec = gymnasium.spec(own)
        merged = _with_tuples({**(spec.kwargs.get("config") or {}), **config})
        keywords: dict[str, Any] = {"config": merged} if merged else {}
        if render_mode:
            keywords["render_mode"] = render_mode
        with warnings.catch_warnings(), ExitStack() as stack:
            warnings.filterwarnings("ignore", message=".*out of date", category=DeprecationWarning)
            stack.enter_context(_kept_classes(spec))
            made: gymnasium.Env[Any, Any] = gymnasium.make(spec, disable_env_checker=True, **keywords)
    except InputError:
        raise
    except gymnasium.error.UnregisteredEnv as error:
        hint = "" if module else f" (if another package registers it, name the module that does, as in module:{own})"
        raise InputError(f"The environment {name!r} cannot be made: {error}{hint}") from error
    except Exception as error:  # gymnasium's other errors, and any error of the environment's package
        reason = str(error).partition(" was raised from the environment creator")[0]  # gymnasium repeats all arguments
        raise InputError(f"The environment {name!r} cannot be made: {type(error).__name__}: {reason}") from error
    return made
