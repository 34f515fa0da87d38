"""Contract of driving systems, see `behavexplor.ads.interface.ADS`."""

from typing import Any, Final

import numpy as np

from behavexplor.data.scenario import Scenario
from behavexplor.execution.ads_error import ADSError
from behavexplor.execution.preflight import preflight_warnings
from behavexplor.execution.simulation import Simulation
from behavexplor.testing.contract import ContractError, promise

SCENARIOS: Final = 4


def check_ads(ads: Any, *, env: str = "intersection-straight", scenarios: int = SCENARIOS) -> list[str]:
    """Check that a driving system keeps the promises of `behavexplor.ads.interface.ADS`.

    Args:
        ads: the driving system, or its name as for `--ads`.
        env: the environment in which it drives.
        scenarios: number of scenarios that it drives, at least 2.

    Returns:
        Warnings, a sentence each: the system always answers the same, or never moves.

    Raises:
        ContractError: if a promise is broken.
        InputError: if there is no such system or environment, or they do not fit each other.
    """
    simulation = Simulation(env, ads)
    try:
        generator = np.random.default_rng(0)
        chosen = [simulation.logical.sample(generator) for _ in range(max(scenarios, 2))]
        alone = [_driven(simulation, scenario) for scenario in chosen]
        again = [_driven(simulation, scenario) for scenario in reversed(chosen)]
        promise(
            alone == again[::-1],
            "The same scenario gave another trace when it was driven again after other scenarios: decide "
            "deterministically, and keep nothing from one episode to the next",
        )
        if getattr(simulation.ads, "vectorized", False):
            together = dict(simulation.run_all(chosen, len(chosen)))
            promise(
                [together[i].to_bytes() for i in range(len(chosen))] == alone,
                "`vectorized` is true, but an episode in a batch is not the episode alone: decide each row from "
                "its own observation and state",
            )
        return preflight_warnings(simulation)
    finally:
        simulation.close()


def _driven(simulation: Simulation, scenario: Scenario) -> bytes:
    try:
        return simulation.run(scenario).to_bytes()
    except ADSError as error:
        raise ContractError(f"In a valid scenario {error}") from error
