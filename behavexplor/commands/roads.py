"""Roads of executions that are exchanged with other tools, and the libraries that this takes."""

from collections.abc import Mapping
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, Final

from behavexplor.data.drawn_scenario import DrawnScenario
from behavexplor.data.road_plan import RoadPlan, plan_of_map
from behavexplor.data.scenario import LogicalScenario, Scenario
from behavexplor.envs.making import make_env, make_recorded
from behavexplor.errors import missing_library
from behavexplor.execution.simulation import logical_of

LIBRARIES: Final = ("lxml", "scenariogeneration")  # of the extra `scenes`
_highway_env = lru_cache(maxsize=1)(make_recorded)  # an environment takes longer to make than a scene to write


def check_libraries() -> None:
    """Check that the libraries of the extra `scenes` are installed.

    Raises:
        InputError: if one of them is missing.
    """
    for library in LIBRARIES:
        if find_spec(library) is None:
            raise missing_library("The exchange of scenes", library, "scenes")


def road_of(scenario: Scenario | None, env: str, env_config: Mapping[str, Any]) -> tuple[RoadPlan, LogicalScenario]:
    """Return the road of a scenario, and the scenarios of its environment.

    The scenario may be None if its environment has one road for all. `env_config` is the environment's configuration as
    far as it differs from the default; a scenario of highway-env's environments has its own.

    Raises:
        InputError: if the environment cannot be made, or has a road that cannot be exported.
    """
    if isinstance(scenario, DrawnScenario):
        drawn = _highway_env(scenario.setup)
        drawn.begin_blindly(scenario)
        return drawn.road_plan(), drawn.logical
    made = make_env(env, env_config)
    logical = logical_of(made, env)
    made.close()
    return () if logical.roadmap is None else plan_of_map(logical.roadmap), logical
