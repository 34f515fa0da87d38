"""Load driving systems under test by name, and make drivers of plain functions."""

import inspect
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, cast

import numpy as np

from behavexplor.ads.interface import ADS
from behavexplor.ads.learned.driver import LearnedDriver
from behavexplor.ads.learned.network_file import Rule, read_network
from behavexplor.ads.sb3.archive import read_archive
from behavexplor.ads.sb3.description import WEIGHTS, Description, describe, find_model, is_policy
from behavexplor.data.array_types import Array, Bools
from behavexplor.data.drawn_scenario import DECLARATIONS
from behavexplor.data.observations import Observation, mapped
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.target import Activation
from behavexplor.errors import InputError, described, missing_library, unknown_name

SYSTEMS = MappingProxyType(
    {
        "rule": "behavexplor.ads.rule.profiles:rule_planner",
        "learned": "behavexplor.ads.learned.shipped:learned_driver",
        "idm": "behavexplor.ads.idm:idm_driver",
        "constant": "behavexplor.ads.constant:constant_driver",
        "careful": "behavexplor.ads.careful:careful_driver",
    }
)
_ON_ROUTES = ("rule", "learned", "idm")  # systems that follow a route on the roads of this package
IN_MEMORY = "in-memory"  # in place of the module, in the name of a driver that existed in one process only
_BY_POSITION: Final = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
_VARIADIC: Final = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def is_shipped(name: str) -> bool:
    """Return whether an ADS is a program of this package, which reads at most numbers from a file."""
    return name.partition(":")[0] in SYSTEMS or name.endswith(".npz")


def check_name(name: str) -> None:
    """Refuse a name that cannot denote an ADS, without loading anything.

    Raises:
        InputError: if the name is neither a system of this package, nor a file, nor "module:attribute". If it is like
            one that exists, the message says so.
    """
    system, separator, variant = name.partition(":")
    module = name.removesuffix(".py")
    if system not in SYSTEMS and not separator and Path(f"{module}.py").is_file():
        driver = f"{Path(module).name}:MyDriver"
        raise InputError(f"{name!r} is a Python module: in its folder, name the driver in it, such as {driver}")
    if system.endswith(".py") and separator and Path(system).is_file():
        raise InputError(f"{name!r} names a file: in the folder of {system}, write {Path(system).stem}:{variant}")
    if not (separator or Path(name).exists()) and Path(f"{name}.zip").is_file():
        raise InputError(f"There is no file {name}: did you mean {name}.zip?")
    if name.endswith((".zip", ".npz", *WEIGHTS)) and not Path(name).exists():
        raise InputError(f"There is no file {name}")
    if not (separator or system in SYSTEMS or name.endswith(".npz") or is_policy(name)):
        raise unknown_name('ADS (a known name, a policy file, or your own "module:attribute")', name, SYSTEMS)


def load_ads(
    name: str, roadmap: RoadMap | None, trust: Collection[str] = (), activation: Activation | None = None
) -> ADS:
    """Load a driving system under test by name.

    Args:
        name: a system of `SYSTEMS`, with or without a variant after a colon, such as "rule" or "rule:hardened"; or
            a policy file of `behavexplor.training` (.npz) or of Stable-Baselines3 (.zip, or a folder, see
            `behavexplor.ads.sb3.policy.load_policy`), or of weights alone (see
            `behavexplor.ads.weights.weights_policy.load_weights`); or
            "package.module:attribute" of an object with a `predict` method (see `behavexplor.ads.interface.ADS`), of
            a function from one observation to one action, or of a class or function that makes such an object or
            function. A class or function with a parameter `roadmap` receives the road map.
        roadmap: road map for the ADS; None in a highway-env environment, whose road is its own.
        trust: digests ("sha256:...") of files that may execute code of their own while they are loaded.
        activation: function between the layers of a file of weights; None for that in the file beside it.

    Raises:
        InputError: if no ADS has that name, or the object of that name cannot predict.
    """
    check_name(name)
    system, _, variant = name.partition(":")
    if system in _ON_ROUTES:
        roadmap = _roads_for(f"The driving system {name!r}", roadmap)
    if system in SYSTEMS:
        module_name, _, factory = SYSTEMS[system].partition(":")
        ads: ADS = getattr(import_module(module_name), factory)(roadmap, variant)
        return ads
    if name.endswith(".npz") or is_policy(name):
        return _policy(Path(name), roadmap, trust, activation)
    module_name, _, attribute = name.partition(":")
    if module_name == IN_MEMORY:
        raise InputError(
            f"The driver was an object in memory ({attribute}), which no command can load: give it again in Python, "
            f"by behavexplor.open_run(FOLDER, driver)"
        )
    try:
        found = getattr(import_module(module_name), attribute)
    except Exception as error:  # a module can raise anything when it is imported
        hint = " (modules are looked for in this folder and on PYTHONPATH)" if isinstance(error, ImportError) else ""
        raise InputError(f"The ADS {name!r} cannot be imported: {described(error)}{hint}") from error
    return _made(name, found, roadmap)


def _roads_for(subject: str, roadmap: RoadMap | None) -> RoadMap:
    """Return the road map, or refuse a driver that needs one if there is none. `subject` begins the message."""
    if roadmap is None:
        raise InputError(
            f"{subject} follows a route on the roads of this package: in an environment of highway-env, name a policy "
            f"file, your own module:attribute, careful, or constant:ACTION"
        )
    return roadmap


def _policy(path: Path, roadmap: RoadMap | None, trust: Collection[str], activation: Activation | None) -> ADS:
    """Load the policy in a file or folder."""
    if path.suffix == ".npz":
        network = read_network(path)
        return LearnedDriver(_roads_for(f"The driving system {str(path)!r}", roadmap), network)
    try:
        from behavexplor.ads.sb3.policy import load_policy  # noqa: PLC0415 - torch is heavy, and need not be installed
        from behavexplor.ads.sb3.wrappers import in_wrappers  # noqa: PLC0415
        from behavexplor.ads.weights.weights_policy import load_weights  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise missing_library(str(path), error.name, "rl") from None
    model = find_model(path)
    description = describe(model)
    if model.suffix in WEIGHTS:
        policy: Any = load_weights(model, activation)
    elif description.decision is None:
        policy = load_policy(path, trust)
    else:
        _check_features(model, description)
        policy = _learned(model, description.decision, roadmap, trust)
    ads: ADS = in_wrappers(policy, model, description.wrappers, trust)
    return ads


def _check_features(model: Path, description: Description) -> None:
    """Refuse a network of `train` that is described as seeing anything but the features."""
    if description.statistics is not None or description.frame_stack > 1:
        raise InputError(f"{model} is described as a network of `train`, whose features are neither scaled nor stacked")


def _learned(model: Path, rule: Rule, roadmap: RoadMap | None, trust: Collection[str]) -> Any:
    """Return the driver of a network of `train` that was saved as a model of SB3; refuse it where there is no route."""
    from behavexplor.ads.sb3.dense_layers import trained_network  # noqa: PLC0415 - see `_policy`
    from behavexplor.ads.sb3.policy import load_network  # noqa: PLC0415

    roads = _roads_for(f"{model}, a network of `train`,", roadmap)
    network = load_network(read_archive(model), trust)
    return LearnedDriver(roads, trained_network(network, rule))


def _made(name: str, found: Any, roadmap: RoadMap | None) -> ADS:
    """Return the object of a name if it is an ADS, or else the ADS that it makes."""
    ads = as_driver(found)
    if ads is None:
        if not callable(found):
            raise InputError(f"{name!r} is not an ADS: it has no predict method and cannot make an object that has one")
        made = _call(name, found, roadmap)
        ads = None if isinstance(made, type) else as_driver(made)
        if ads is None:
            raise InputError(f"{name!r} is not an ADS: the object that it makes, {made!r:.80}, has no predict method")
    return ads


def _call(name: str, factory: Callable[..., Any], roadmap: RoadMap | None) -> Any:
    """Call a class or function, with the road map if it has a parameter `roadmap`."""
    keywords = {"roadmap": roadmap} if "roadmap" in parameters_of(factory) else {}
    missing = [repr(one.name) for one in needed_parameters(factory) if one.name not in keywords]
    if missing:
        raise InputError(
            f"The ADS {name!r} cannot be created: it needs {' and '.join(missing)}, and is called with no arguments; "
            "name an object with a predict method, a function of one observation, or a class that needs no arguments"
        )
    try:
        return factory(**keywords)
    except Exception as error:
        raise InputError(f"The ADS {name!r} cannot be created: {described(error)}") from error


def as_driver(found: Any) -> ADS | None:
    """Return an object with a `predict` method as it is, and a function of one observation as a driver.

    None for anything else, such as a class.

    Raises:
        InputError: if the attribute `predict` cannot be looked up.
    """
    if isinstance(found, type):
        return None
    try:
        predicts = callable(getattr(found, "predict", None))
    except Exception as error:  # a property can raise anything
        raise InputError(f"The predict method of the driver cannot be looked at: {described(error)}") from error
    if predicts:
        return cast("ADS", found)
    if callable(found) and takes_one_observation(found):
        return cast("ADS", FunctionDriver(found))
    return None


class FunctionDriver:
    """A function from one observation to one action, which drives one episode at a time.

    Attributes of the function that declare its observations and actions (`DECLARATIONS`) are those of the driver.
    Without them, it observes and acts as the environment does by default.
    """

    vectorized = False
    is_function = True  # so that messages speak of a function instead of `predict`

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self._function = function
        for name in DECLARATIONS:
            if hasattr(function, name):
                setattr(self, name, getattr(function, name))

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: Bools | None = None,  # noqa: ARG002 - the function keeps nothing
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Array, Any]:
        """Choose the action of the only ego; see `behavexplor.ads.interface.ADS`."""
        action = self._function(mapped(lambda rows: rows[0], observation))
        return _row(action), state


def _row(action: Any) -> Array:
    """Return an action as a batch of one. An answer that cannot be an array is kept, and refused by its check."""
    try:
        return np.asarray(action)[None]
    except ValueError:
        kept = np.empty(1, dtype=object)
        kept[0] = action
        return kept


def takes_one_observation(function: Callable[..., Any]) -> bool:
    """Return whether a callable needs exactly one argument, and so takes an observation.

    A factory needs none, or the road map in its parameter `roadmap`.
    """
    needed = needed_parameters(function)
    return len(needed) == 1 and needed[0].kind in _BY_POSITION and needed[0].name != "roadmap"


def needed_parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """Return the parameters without which a callable cannot be called."""
    return [one for one in parameters_of(function).values() if one.default is one.empty and one.kind not in _VARIADIC]


def parameters_of(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    """Return the parameters of a callable by name; none if Python cannot tell them."""
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):
        return {}
