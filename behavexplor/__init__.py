"""BehAVExplor: fuzz a driving policy in traffic scenarios on highway-env to find out how it fails.

Importing this package only registers the environments `behavexplor/<functional scenario>-v0` with gymnasium. The
simulator is imported when an environment is made.
"""

import pkgutil
from pathlib import Path

import gymnasium

__version__ = "0.1.0"

NAMESPACE = "behavexplor"


def _functional_scenarios() -> dict[str, str]:
    """Return the entry points of the functional scenarios' environments by name, one for each file in its folder."""
    folder = Path(__file__).parent / "envs" / "functional"
    modules = sorted(module.name for module in pkgutil.iter_modules([str(folder)]))
    return {
        module.replace("_", "-"): f"behavexplor.envs.functional.{module}:{module.title().replace('_', '')}Env"
        for module in modules
    }


FUNCTIONAL_SCENARIOS = _functional_scenarios()

for _name, _entry_point in FUNCTIONAL_SCENARIOS.items():
    _id = f"{NAMESPACE}/{_name}-v0"
    if _id not in gymnasium.registry:
        _vector_entry_point = _entry_point.removesuffix("Env") + "VectorEnv"
        gymnasium.register(_id, entry_point=_entry_point, vector_entry_point=_vector_entry_point)
