"""The file of a model, and what the files beside it say: environment, configuration, preparation of observations."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Final, Literal

import yaml
from pydantic import ConfigDict, Field

from behavexplor import FUNCTIONAL_SCENARIOS
from behavexplor.ads.learned.network_file import Rule
from behavexplor.ads.learned.shipped import policy_file
from behavexplor.ads.sb3.highway_fit import HIGHWAY_ENVIRONMENTS
from behavexplor.data.named_code import env_code
from behavexplor.data.target import Activation
from behavexplor.data.untrusted import parse_json, parse_yaml, read_file
from behavexplor.data.validation import checked
from behavexplor.errors import InputError, brief

MAX_BYTES: Final = 1_000_000  # greatest size of a file of settings
OWN: Final = (".yaml", ".yml")  # endings of the file with a model's settings beside it
STATISTICS: Final = ("vecnormalize.pkl", "vec_normalize.pkl")  # the names by rl-zoo3, on disk and on the Hub
# Endings of files that hold weights alone; those of rl_agents end with .tar.
WEIGHTS: Final = (".pth", ".pt", ".safetensors", ".tar", ".ckpt", ".bin", ".cleanrl_model")
_KERAS: Final = "a model of Keras: write its weights to a file of safetensors by a function of six lines"
_ELSEWHERE: Final = {  # what is not read, with the way out
    ".h5": _KERAS,
    ".keras": _KERAS,
    ".onnx": "a program of ONNX, which is not run: write a driver of ten lines and name it as module:attribute",
}
_CHECKPOINT: Final = re.compile(r"^(.+)_(\d+)_steps$")  # the name of a model by Stable-Baselines3's CheckpointCallback
# Wrappers that change neither what a policy observes nor what it does here, as rl-zoo3 names them.
_HARMLESS: Final = (
    "stable_baselines3.common.vec_env.VecMonitor",
    "stable_baselines3.common.vec_env.VecCheckNan",
    "stable_baselines3.common.monitor.Monitor",
    "gymnasium.wrappers.TimeLimit",
    "gymnasium.wrappers.time_limit.TimeLimit",
    "gym.wrappers.TimeLimit",
    "gymnasium.wrappers.FlattenObservation",  # `behavexplor.ads.sb3.policy` flattens if the policy's space says so
    "gym.wrappers.FlattenObservation",
)
_METADATA: Final = "metadata*.json"  # of a run of rl_agents
_OF_SPEC: Final = ("id", "import_module")  # what rl_agents writes beside an environment's configuration
_ORDERED_DICT = "tag:yaml.org,2002:python/object/apply:collections.OrderedDict"
ENVIRONMENT_KEYS: Final[tuple[str, ...]] = ("observation", "action", "policy_frequency", "simulation_frequency")


@dataclass(frozen=True, kw_only=True)
class Description:
    """Settings that a policy needs besides its network."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    # highway-env's observation configuration; None for the environment's own
    observation: Mapping[str, Any] | None = None
    action: Mapping[str, Any] | None = None  # highway-env's action configuration; None for the environment's own
    policy_frequency: int | None = None  # decisions per second [Hz]; None for the environment's own
    simulation_frequency: int | None = None  # simulation steps per second [Hz]; None for the environment's own
    env: str | None = None  # name of the environment in which the policy was trained; None if unknown
    config: Mapping[str, Any] | None = None  # highway-env's configuration in training; None if unknown
    frame_stack: Annotated[int, Field(ge=1)] = 1  # number of observations stacked by `VecFrameStack`
    # rule by which the actor of a network of `train` decides, see `behavexplor.ads.learned.deciding`; None for a policy
    # with observations and actions of highway-env
    decision: Rule | None = None
    statistics: Path | None = None  # file of `VecNormalize`; None if observations were not normalized
    # wrappers of the training, "module:Class" or a mapping from it to its arguments, the innermost first
    wrappers: tuple[str | Mapping[str, Mapping[str, Any]], ...] = ()
    # what a file of weights does not say itself; None if unknown
    activation: Activation | None = None  # function between the layers
    network: str | None = None  # name of the network that acts
    output: Literal["values", "logits", "mean"] | None = None  # what the last layer gives
    squash: bool | None = None  # whether tanh follows the last layer of a policy with continuous actions
    strides: tuple[Annotated[int, Field(ge=1, le=100)], ...] | None = None  # strides of the convolutions
    paddings: tuple[Annotated[int, Field(ge=0, le=100)], ...] | None = None  # paddings of the convolutions; None for 0
    about: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))  # free notes of the author; ignored


def is_policy(ads: str) -> bool:
    """Return whether the name of a driving system is that of a file or folder."""
    return ads.endswith((".zip", *WEIGHTS)) or Path(ads).exists()


def find_model(path: Path) -> Path:
    """Return the path of the model's file: the path itself, or that of the model in a run folder of rl-zoo3.

    Raises:
        InputError: if there is no model, or more than one that could be meant.
    """
    if path.is_file():
        if path.suffix in _ELSEWHERE:
            raise InputError(f"{path} is {_ELSEWHERE[path.suffix]} (docs/policies.md)")
        return path
    if not path.is_dir():
        raise InputError(f"{path} is not a regular file" if path.exists() else f"There is no file or folder {path}")
    models = sorted(path.glob("*.zip"))
    named = [model for model in models if (path / model.stem / "args.yml").is_file()]
    best = [model for model in models if model.name == "best_model.zip"]
    chosen = named or best or models
    if len(chosen) != 1:
        listed = ", ".join(model.name for model in models) or "none"
        raise InputError(f"{path} must contain one model (a .zip file), but has {listed}: name the file")
    return chosen[0]


def files_of_model(ads: str) -> list[Path]:
    """Return the file of a model and the files beside it that tell how it drives; none for a driver of another kind."""
    if ads.endswith(".npz") or not is_policy(ads):
        return []
    try:
        model = find_model(Path(ads))
    except InputError:  # which is said when the policy is loaded
        return []
    folders = (model.parent, *(arguments.parent for arguments in sorted(model.parent.glob("*/args.yml"))))
    beside = [folder / name for folder in folders for name in ("args.yml", "config.yml", *STATISTICS)]
    beside += sorted(model.parent.glob(_METADATA)) if model.suffix in WEIGHTS else []
    return [path for path in (model, *_of_checkpoint(model), *map(model.with_suffix, OWN), *beside) if path.is_file()]


def named_env(env: str | None, ads: str) -> str | None:
    """Return `env` if one was named, or else the environment in which a policy was trained; None if unknown.

    Raises:
        InputError: if the name is empty, or the files beside the policy name an environment of another package.
    """
    if env == "":
        raise InputError("The name of the environment is empty: leave it out, or give one such as highway-fast-v0")
    found = env or trained_in(ads)
    if env is None and found is not None and env_code(found):
        raise InputError(
            f"The files beside {ads} name {found!r} of another package: add --env {found} (in Python, env) to load it"
        )
    return found


def trained_in(ads: str) -> str | None:
    """Return the environment in which a policy was trained, if the files beside its model or network name it.

    `ads` is the name of any driving system.
    """
    try:
        if ads.startswith("learned:") or ads.endswith(".npz"):
            return env_in_card(policy_file(ads))
        return describe(find_model(Path(ads))).env if is_policy(ads) else None
    except InputError:  # which is said when the policy is loaded
        return None


def env_in_card(network: Path) -> str | None:
    """Return the functional scenario that the card beside a network of `train` names; None if there is none.

    Raises:
        InputError: if the card cannot be read.
    """
    card = network.with_suffix(OWN[0])
    training = _read(card).get("training") if card.is_file() else None
    env = training.get("env") if isinstance(training, dict) else None
    return env if isinstance(env, str) and env in FUNCTIONAL_SCENARIOS else None


def describe(model: Path) -> Description:
    """Read the files beside a model: `<model>.yaml`, or those of rl-zoo3 or rl_agents; and the statistics.

    The files of rl-zoo3 are in a folder beside the model, or, as on the Hugging Face Hub, beside the model themselves.

    Raises:
        InputError: if a file cannot be read, or asks for something that is not supported.
    """
    own = next((file for file in map(model.with_suffix, OWN) if file.is_file()), None)
    folders = [arguments.parent for arguments in sorted(model.parent.glob("*/args.yml"))]
    if (model.parent / "args.yml").is_file():
        folders = [model.parent]
    if own is not None:
        description = _own(own)
    elif len(folders) == 1:
        description = _of_zoo(folders[0], model)
    elif model.suffix in WEIGHTS and len(metadata := sorted(model.parent.glob(_METADATA))) == 1:
        description = _of_rl_agents(metadata[0])
    else:
        description = Description()
    if description.statistics is None and description.decision is None:  # a network of `train` has none of its own
        return replace(description, statistics=_statistics_in(model.parent, model))
    return description


def _statistics_in(folder: Path, model: Path) -> Path | None:
    """Return the file of statistics of a checkpoint, or else the one in a folder; None if there is none."""
    if named := [path for path in _of_checkpoint(model) if path.is_file()]:
        return named[0]
    found = [folder / name for name in STATISTICS if (folder / name).is_file()]
    if len(found) > 1:
        names = " and ".join(STATISTICS)
        raise InputError(f"{folder} has {names}: name one of them as `statistics` in {model.with_suffix('.yaml').name}")
    return found[0] if found else None


def _of_checkpoint(model: Path) -> list[Path]:
    """Return the path at which CheckpointCallback saves a model's statistics; none if the name is not its own."""
    return [model.with_name(f"{name}_vecnormalize_{n}_steps.pkl") for name, n in _CHECKPOINT.findall(model.stem)]


def _own(path: Path) -> Description:
    values = _read(path)
    given = values.get("config")
    trained = {key: given[key] for key in ENVIRONMENT_KEYS if key in given} if isinstance(given, dict) else {}
    description = checked(Description, {**trained, **values}, f"settings in {path}")
    if description.statistics is None:
        return description
    statistics = path.parent / description.statistics
    if not statistics.is_file():
        raise InputError(f"{path} names {description.statistics}, which does not exist")
    return replace(description, statistics=statistics)


def _of_zoo(folder: Path, model: Path) -> Description:
    """Read the files that rl-zoo3 writes into a run's folder; it normalizes observations first, then stacks them."""
    arguments = _read(folder / "args.yml")
    settings = _read(folder / "config.yml") if (folder / "config.yml").is_file() else {}
    for wrapper in _wrapper_names(settings):
        if wrapper not in _HARMLESS:
            raise InputError(
                f"{folder / 'config.yml'}: the policy was trained in the wrapper {wrapper!r:.80}, which is "
                "not supported: write a driver that applies it, and name it as module:attribute"
            )
    statistics = _statistics_in(folder, model) or _statistics_in(model.parent, model)
    if settings.get("normalize") and statistics is None:
        raise InputError(
            f"{folder / 'config.yml'} says that observations were normalized, but {STATISTICS[0]} is missing there"
        )
    config = _environment(arguments)
    values = {key: config[key] for key in ENVIRONMENT_KEYS if key in config}
    values |= {"env": arguments.get("env"), "config": config}
    values["frame_stack"] = settings.get("frame_stack") or 1
    values["statistics"] = statistics
    return checked(Description, values, f"settings in {folder}")


def _of_rl_agents(path: Path) -> Description:
    """Read the metadata of a run of rl_agents: the `model` of its agent, and highway-env's configuration.

    Its networks have ReLU between their layers if they do not say otherwise, and its convolutions strides of 2.
    """
    values = _read(path)
    agent, env = (_mapping(values.get(key)) for key in ("agent", "env"))
    model = _mapping(agent.get("model"))
    inner = _mapping(model.get("base_module") or model.get("head_mlp"))
    said: dict[str, Any] = {"activation": str(model.get("activation") or inner.get("activation") or "relu").lower()}
    if model.get("type") == "ConvolutionalNetwork":
        said["strides"] = [2, 2, 2]
    config = {key: value for key, value in env.items() if not key.startswith("__") and key not in _OF_SPEC}
    trained = {key: config[key] for key in ENVIRONMENT_KEYS if key in config}
    found = {**said, **trained, "env": env.get("id"), "config": config or None}
    return checked(Description, found, f"settings in {path}")


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _wrapper_names(settings: Mapping[str, Any]) -> list[Any]:
    """Return the names of the wrappers in a file of rl-zoo3, which may map a name to arguments."""
    given = [settings.get("env_wrapper") or [], settings.get("vec_env_wrapper") or []]
    listed = [one for value in given for one in (value if isinstance(value, list) else [value])]
    return [next(iter(one)) if isinstance(one, dict) and len(one) == 1 else one for one in listed]


def _environment(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the configuration of a policy's training environment: highway-env's default with the policy's changes."""
    keywords = arguments.get("env_kwargs") or {}
    changed = (keywords.get("config") or {}) if isinstance(keywords, Mapping) else {}
    if not isinstance(changed, dict):
        raise InputError(f"env_kwargs of the policy's args.yml has the config {brief(changed)}, which is no mapping")
    return {**HIGHWAY_ENVIRONMENTS.get(str(arguments.get("env")), {}), **changed}


class _Loader(yaml.SafeLoader):
    """A loader of plain values, and of the ordered dictionaries in which rl-zoo3 wraps them."""


_Loader.add_constructor(
    _ORDERED_DICT,
    lambda loader, node: dict(loader.construct_sequence(node, deep=True)[0]),  # type: ignore[arg-type]
)


def _read(path: Path) -> dict[str, Any]:
    try:
        text = read_file(path, MAX_BYTES).decode()
        values = parse_json(text, "the metadata of a run") if path.suffix == ".json" else parse_yaml(text, _Loader)
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read: {error!s:.300}") from None
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise InputError(f"{path} must contain keys and values, such as `policy_frequency: 5`")
    return values
