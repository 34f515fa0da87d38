"""Experiments: read from a file, validated, and laid out as runs, one campaign each."""

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Final

import yaml

from behavexplor.campaign.config import CampaignConfig, campaign_config, read_config
from behavexplor.data.target import Conditions
from behavexplor.data.validation import between, checked
from behavexplor.errors import InputError, brief, unknown_name

EXPERIMENT: Final = "experiment.yaml"  # file in an experiment's folder
MOST_RUNS: Final = 100_000
PAPER_ENVS: Final = ("intersection-straight", "intersection-left", "lane-follow", "lane-change")
_FROM_CONFIG: Final = ("method", "options")  # keys that an experiment accepts in a campaign's configuration


@dataclass(frozen=True)
class MethodChoice:
    """A search method of an experiment."""

    method: str = "behavexplor"  # as in a campaign's `method`
    options: dict[str, Any] = field(default_factory=dict)  # options of the method


@dataclass(frozen=True)
class _MethodEntry(MethodChoice):
    """A search method in an experiment's file, which may name a campaign's configuration file or preset instead."""

    config: str | None = None  # configuration file or preset; None if the entry itself gives the method and its options


@dataclass(frozen=True, kw_only=True)
class Experiment(Conditions):
    """Every search method in every environment with every ADS, once with each seed, all under the same conditions.

    The limits, the traffic, and what the campaigns' code may do are in `Conditions`. `experiment_config` also checks
    the ranges of values.

    Raises:
        InputError: if a limit, a name or a campaign's value is invalid, or there are too many campaigns.
    """

    name: str  # name of the experiment and of its folder
    methods: dict[str, MethodChoice]  # search methods by their names in the tables
    # driving systems under test, as in a campaign's `ads`, in each environment, as in a campaign's `env`
    ads: dict[str, tuple[str, ...]]
    # number of repetitions. Their seeds are `first_seed`, `first_seed` + 1, ..., the same for all campaigns.
    seeds: Annotated[int, between(1, 1000)] = 5
    first_seed: int = 1  # seed of the first repetition
    # number of executions of each campaign. A running time is not allowed, because results would depend on the machine.
    budget: Annotated[int, between(1, 999_999_999)] = 750
    batch: int = 8  # number of candidates in flight, as in a campaign's `batch`
    # number of processes that execute the scenarios of one campaign. 0 is the campaign's own process, without limits of
    # time and memory; a third-party ADS then gets one process, in which it is confined.
    workers: Annotated[int, between(0, 64)] = 0
    specs: tuple[str, ...] = ()  # user-defined requirements, as in a campaign's `specs`
    reference: str = ""  # method that is compared with each other method; by default the first one
    baseline: str = ""  # method that each other method is compared with; empty for none
    # names of additional tables, each with the methods that it shows
    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
    # names of additional families of comparisons, each with the pairs of methods that it compares
    contrasts: dict[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_name("name of the experiment", self.name)
        _check_names("methods", tuple(self.methods))
        for kind, names in (("group", self.groups), ("contrast", self.contrasts)):
            for name in names:
                _check_name(f"name of a {kind}", name)
        named = [name for name in (self.reference, self.baseline) if name]
        named += [member for members in self.groups.values() for member in members]
        named += [member for pairs in self.contrasts.values() for pair in pairs for member in pair]
        for name in named:
            if name not in self.methods:
                raise unknown_name("method of the experiment", name, self.methods)
        count = len(self.places) * len(self.methods) * self.seeds
        if count > MOST_RUNS:
            raise InputError(f"The experiment has {count} campaigns: at most {MOST_RUNS} are allowed")
        self.runs()

    @property
    def compared(self) -> str:
        """Name of the reference method."""
        return self.reference or next(iter(self.methods))

    @property
    def envs(self) -> tuple[str, ...]:
        """Names of the environments."""
        return tuple(self.ads)

    @property
    def systems(self) -> tuple[str, ...]:
        """Names of the driving systems, each once."""
        return tuple(dict.fromkeys(system for systems in self.ads.values() for system in systems))

    @property
    def has_several_ads(self) -> bool:
        """Whether an environment has several driving systems, so that its name alone does not denote a place."""
        return any(len(systems) > 1 for systems in self.ads.values())

    @property
    def places(self) -> list[tuple[str, str]]:
        """Pairs of environment and driving system."""
        return [(env, system) for env, systems in self.ads.items() for system in systems]

    def runs(self) -> list["PlannedRun"]:
        """Return all campaigns seed by seed, so that an unfinished experiment is balanced."""
        campaigns = [
            (env, ads, method, self._campaign(env, ads, choice))
            for env, ads in self.places
            for method, choice in self.methods.items()
        ]
        return [
            PlannedRun(env, ads, method, seed, replace(config, seed=seed))
            for seed in range(self.first_seed, self.first_seed + self.seeds)
            for env, ads, method, config in campaigns
        ]

    def _campaign(self, env: str, ads: str, choice: MethodChoice) -> CampaignConfig:
        """Return the configuration of a method's campaigns in one environment with one ADS, with the default seed."""
        values = {"env": env, "ads": ads, "method": choice.method, "options": choice.options}
        of_all = ("budget", "batch", "specs", *(one.name for one in fields(Conditions)))
        return campaign_config({**values, **{key: getattr(self, key) for key in of_all}})

    def to_yaml(self) -> str:
        """Return the whole experiment as YAML, with the options of its methods."""
        values = asdict(self)
        for one in fields(Conditions):  # move these behind the experiment's own keys
            values[one.name] = values.pop(one.name)
        values |= {key: list(values[key]) for key in ("trust", "specs")}
        values["ads"] = {env: list(systems) for env, systems in self.ads.items()}
        values["groups"] = {name: list(members) for name, members in self.groups.items()}
        values["contrasts"] = {name: [list(pair) for pair in pairs] for name, pairs in self.contrasts.items()}
        return yaml.safe_dump(values, sort_keys=False, allow_unicode=True)


@dataclass(frozen=True)
class PlannedRun:
    """One campaign of an experiment."""

    env: str  # environment
    ads: str  # driving system under test
    method: str  # name of the method in the experiment
    seed: int  # seed of the campaign
    config: CampaignConfig = field(hash=False)  # configuration of the campaign

    @property
    def folder(self) -> Path:
        """Path of the run folder, relative to the experiment's folder."""
        return Path("runs", slug(self.env), slug(self.ads), slug(self.method), str(self.seed))

    def __str__(self) -> str:
        """Return a description of the campaign for messages."""
        return f"{self.method} on {self.env} with {self.ads}, seed {self.seed}"


def slug(name: str) -> str:
    """Return a name as a folder name."""
    return re.sub(r"[^\w.+~-]+", "-", name).strip(".-") or "-"


def read_experiment(name: str) -> Experiment:
    """Read an experiment from a YAML file, or by the name of a file in `configs/experiments/`, such as "quick".

    Raises:
        InputError: if there is no such file, or if it holds no valid experiment.
    """
    what = "experiment (neither a file nor a shipped experiment)"
    values = read_config(name, what=what, folder="experiments")
    return experiment_config({"name": Path(name).stem, **values})


def experiment_config(values: Mapping[str, Any]) -> Experiment:
    """Return an experiment from plain values.

    Raises:
        InputError: if a value is unknown, of a wrong type or out of range; the message names the first such value.
    """
    methods = values.get("methods")
    if not isinstance(methods, Mapping) or not methods:
        raise InputError("methods of the experiment must name the methods, such as `Uniform: {method: uniform}`")
    choices = {str(name): _choice(str(name), entry) for name, entry in methods.items()}
    known = [one.name for one in fields(Experiment)] + ["envs"]
    for key in values:
        if key not in known:
            raise unknown_name("key of the experiment", str(key), known)
    others = {key: value for key, value in values.items() if key != "envs"}
    return checked(Experiment, {**others, "ads": _systems(values), "methods": choices}, "experiment")


def _systems(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the driving systems in each environment; an experiment's file may give two lists in place of them."""
    ads = values.get("ads", ("rule",))
    if isinstance(ads, Mapping):
        if "envs" in values:
            raise InputError("envs of the experiment must be left out, because ads names the environments")
        _check_names("envs", list(ads))
        for systems in ads.values():
            _check_names("ads", systems)
        return dict(ads)
    envs = values.get("envs", PAPER_ENVS)
    _check_names("envs", envs)
    _check_names("ads", ads)
    return dict.fromkeys(envs, ads)


def _choice(name: str, entry: Any) -> MethodChoice:
    """Return a method from its entry in the experiment, or from the campaign's configuration that the entry names."""
    what = f"method {name!r} of the experiment"
    if not isinstance(entry, Mapping) or not entry:
        raise InputError(f"The {what} must have the key `method: NAME` or `config: PRESET`")
    read = checked(_MethodEntry, entry, what)
    if read.config is None:
        return MethodChoice(read.method, read.options)
    if len(entry) > 1:
        raise InputError(f"The {what} has a config: give either the config alone, or method and options without it")
    values = read_config(read.config)
    foreign = [key for key in values if key not in _FROM_CONFIG]
    if foreign:
        raise InputError(f"The {what} has a config that sets {foreign[0]!r}: set that for the whole experiment instead")
    return checked(MethodChoice, values, f"config {read.config!r} of the {what}")


def _check_names(key: str, values: Any) -> None:
    """Refuse anything but a list of names, of which no two share a folder."""
    if not isinstance(values, list | tuple) or not all(isinstance(value, str) for value in values):
        raise InputError(f"{key} of the experiment must be a list of names, not {brief(values)}")
    if not values:
        raise InputError(f"{key} of the experiment must not be empty")
    slugs = [slug(value) for value in values]
    for i in range(len(slugs)):
        if slugs[i] in slugs[:i]:
            raise InputError(f"{key} of the experiment: {values[i]!r} and another entry share a folder: change a name")


def _check_name(what: str, name: str) -> None:
    if not re.fullmatch(r"[\w.+-]{1,100}", name) or name.startswith("."):
        raise InputError(f"The {what}, {name!r}, must consist of letters, digits, '-', '_', '+' or '.', as a file name")
