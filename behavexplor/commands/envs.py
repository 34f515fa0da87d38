"""`behavexplor envs`: the environments that can be fuzzed."""

from importlib import import_module
from importlib.metadata import entry_points

import gymnasium

from behavexplor import FUNCTIONAL_SCENARIOS
from behavexplor.commands import OK
from behavexplor.commands.wording import say
from behavexplor.envs.making import ENTRY_POINTS, highway_ids


def envs() -> int:
    """List the environments that `--env` takes: those of this package, of highway-env, and of installed packages."""
    _list("Scenarios of this package, in gymnasium behavexplor/NAME-v0:", list(FUNCTIONAL_SCENARIOS))
    _list("highway-env's own:", highway_ids())
    _list("Of installed packages:", _of_packages())
    return OK


def _of_packages() -> list[str]:
    """Return the ids of environments whose packages declare them."""
    namespaces = []
    for entry in entry_points(group=ENTRY_POINTS):
        import_module(entry.module)
        namespaces.append(f"{entry.name}/")
    return [name for name in gymnasium.registry if name.startswith(tuple(namespaces))]


def _list(title: str, names: list[str]) -> None:
    if names:
        say("\n  ".join([title, *sorted(names)]))
