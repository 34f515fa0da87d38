"""The search methods by name. Their modules are imported on demand."""

from importlib import import_module
from types import MappingProxyType
from typing import Final

from behavexplor.errors import InputError, unknown_name
from behavexplor.fuzz.search import SearchMethod

METHODS = MappingProxyType(
    {
        "behavexplor": "behavexplor.fuzz.behavexplor:BehAVExplor",
        "random": "behavexplor.fuzz.random_mutation:RandomMutation",
        "avfuzzer": "behavexplor.fuzz.avfuzzer:AVFuzzer",
        "samota": "behavexplor.fuzz.samota:SAMOTA",
        "nsga2": "behavexplor.fuzz.nsga2:NSGA2",
        "map-elites": "behavexplor.fuzz.quality_diversity:MAPElites",
        "novelty-search": "behavexplor.fuzz.quality_diversity:NoveltySearch",
        "encounters": "behavexplor.fuzz.encounters:Encounters",
        "niching": "behavexplor.fuzz.niching:Niching",
        "uniform": "behavexplor.fuzz.uniform:Uniform",
    }
)
GIVEN: Final = "behavexplor.fuzz.given:Given"  # executes the scenarios of a file, and searches nothing
SHIPPED: Final = frozenset({*METHODS, *METHODS.values(), GIVEN})


def load_method(name: str) -> type[SearchMethod]:
    """Return the class of a search method, one of `METHODS` or "package.module:attribute".

    Raises:
        InputError: if there is no search method of that name.
    """
    target = METHODS.get(name, name)
    module_name, separator, attribute = target.partition(":")
    if not separator:
        raise unknown_name("search method", name, METHODS)
    try:
        method = getattr(import_module(module_name), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"The search method {name!r} cannot be imported: {error}") from error
    missing = [part for part in ("Options", "ask", "tell", "status") if not hasattr(method, part)]
    if not isinstance(method, type) or missing:
        lacks = f"it lacks {', '.join(missing)}" if missing else "it is not a class"
        raise InputError(f"{name!r} is not a search method: {lacks}; see behavexplor.fuzz.search.SearchMethod")
    return method


def describe_method(name: str) -> str:
    """Return the one-line description of a search method: the first line of its docstring."""
    return (load_method(name).__doc__ or "").strip().partition("\n")[0]
