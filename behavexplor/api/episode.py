"""One execution as an environment, for a loop of the user's own."""

from typing import Any

import gymnasium

from behavexplor.data.scenario import Scenario
from behavexplor.errors import InputError
from behavexplor.execution.rollout import EpisodeDriver
from behavexplor.execution.simulation import Simulation


class Episode(gymnasium.Wrapper[Any, Any, Any, Any]):
    """The environment in which a scenario was executed, as the driver saw it. Each `reset` begins the scenario.

    Rendering and `unwrapped` are those of the environment. At the end of the episode, `info["trace"]` is its trace.
    """

    def __init__(self, simulation: Simulation, scenario: Scenario) -> None:
        super().__init__(simulation.env)
        self._scenario, self._simulation = scenario, simulation
        self._driver: EpisodeDriver | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the scenario, or the one in `options`."""
        scenario = (options or {}).get("scenario", self._scenario)
        self._driver = EpisodeDriver(self._simulation.driver(1), self.action_space, scenario)
        return self.env.reset(seed=seed, options={**(options or {}), "scenario": scenario})

    def driver(self, observation: Any) -> Any:
        """Return the action of the run's driver after an observation of this episode.

        Raises:
            InputError: if no episode has begun.
            behavexplor.execution.executor.ADSError: if the driver fails.
        """
        if self._driver is None:
            raise InputError("The episode has not begun: call reset first")
        return self._driver(observation)
