"""Campaigns from Python: on a driver in memory or by name, with the same engine and the same records as the command."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium

from behavexplor.ads.in_memory import GivenDriver, given_driver
from behavexplor.api.conducting import conduct
from behavexplor.api.given_environments import environment_of, given_config
from behavexplor.api.observers import Observer
from behavexplor.api.run import Run
from behavexplor.campaign.config import CampaignConfig, campaign_config, run_folder
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError, brief
from behavexplor.execution.simulation import default_method

Requirement = str | Callable[[Trace], float]


def find_failures(  # noqa: PLR0913 - one argument for each choice
    driver: Any,
    env: str | gymnasium.Env[Any, Any] | None = None,
    *,
    method: str | None = None,
    budget: int | str = CampaignConfig.budget,
    seed: int = CampaignConfig.seed,
    specs: Sequence[Requirement] = (),
    env_config: Mapping[str, Any] | None = None,
    workers: int | None = None,
    out: str | Path | None = None,
    stop_after: int | None = None,
    progress: bool | Observer | None = None,
    **settings: Any,
) -> Run:
    """Search for scenarios in which a driver fails, and store every execution in a run folder.

    The records are those of `behavexplor fuzz` with the same settings, byte for byte.

    Args:
        driver: a function from one observation to one action; an object with a `predict` method; a model of
            Stable-Baselines3, whose policy is tested as it is now; or a name, as `--ads` takes it.
        env: id of the environment, or an environment of gymnasium, whose id and configuration are taken. By default
            the environment in which the model was trained, or else intersection-straight.
        method: search method, see docs/methods.md; by default BehAVExplor, or uniform draws in highway-env's
            environments, where no guided method of this package finds more.
        budget: number of executions, or running time such as "90s" or "30m"; by default 750 executions.
        seed: random seed, by default 0. The same seed gives the same records.
        specs: requirements in addition to R1, R2 and R3: functions from a trace to its signed robustness, defined at
            the top level of a module or notebook, or their names as "module:attribute".
        env_config: configuration of the environment, as far as it differs from its own. An empty one says that the
            driver was trained in the environment's own.
        workers: number of worker processes, which has no effect on the records. By default none, or one if the driver
            is the name of third-party code, which is confined. Several need a driver that is given by name.
        out: run folder, new or empty; by default a new one in runs/.
        stop_after: number of failures after which the search ends before its budget is used up.
        progress: whether progress is shown; by default only in notebooks. Or a function that gets the
            `behavexplor.campaign.progress.Progress`.
        settings: further keys of the configuration, see `behavexplor.campaign.config.CampaignConfig`.

    Raises:
        InputError: if an argument cannot be used.
        behavexplor.Interrupted: after Ctrl-C. The run can be resumed.
        behavexplor.campaign.campaign.ExecutionError: if a scenario could not be executed for a reason other than the
            driver.
    """
    given = given_driver(driver)
    chosen = {} if method is None else {"method": method}
    config = config_of(given, env, env_config, specs, **chosen, budget=str(budget), seed=seed, **settings)
    folder = Path(out) if out is not None else run_folder(config)
    conduct(config, folder, given, workers=workers, stop_after=stop_after, progress=progress)
    return Run(folder, given)


def config_of(
    given: GivenDriver,
    env: str | gymnasium.Env[Any, Any] | None,
    env_config: Mapping[str, Any] | None,
    specs: Sequence[Requirement],
    **values: Any,
) -> CampaignConfig:
    """Return the configuration of a campaign. `env`, `env_config` and `specs` are those of `find_failures`.

    The other values are by the keys of the configuration.

    Raises:
        InputError: if a value cannot be used.
    """
    if callable(specs) or isinstance(specs, str):
        raise InputError(f"specs must be a list, such as [requirement], got {brief(specs)}")
    name, changes = environment_of(given.env_or_trained_in(env) or CampaignConfig.env)
    found = {"env": name, "ads": given.name, "specs": [_spec_name(spec) for spec in specs]}
    whole = {**found, "env_config": given_config(changes, env_config), **values}
    return campaign_config({"method": default_method(name), **whole})


def _spec_name(spec: Requirement) -> str:
    """Return the name by which this process can import a requirement."""
    if isinstance(spec, str):
        return spec
    name = getattr(spec, "__qualname__", "")
    if not name.isidentifier():
        raise InputError(
            f"The requirement {brief(spec)} has no name by which it can be found again: define it as a function at the "
            f"top level of a module or notebook"
        )
    return f"{spec.__module__}:{name}"
