"""Concrete scenarios of highway-env environments: the random draws that an environment makes for one episode.

A `DrawnScenario` is a frozen value, from which the environment makes the same episode again.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final, Literal, Self

import numpy as np

from behavexplor.data.conventions import MANEUVERS
from behavexplor.data.untrusted import object_fields
from behavexplor.errors import InputError, brief

Traffic = Literal["default", "wide"]  # kinds of traffic, see `Setup`
DEFAULT: Final = "default"
WIDE: Final = "wide"
TRAFFIC: Final = (DEFAULT, WIDE)
DECLARED: Final = ("observation", "action", "policy_frequency", "simulation_frequency")  # by a driver
DECLARATIONS: Final = (*DECLARED, "env_config")  # attributes by which a driver declares what it needs
MAX_DRAWS: Final = 20_000  # draws of one episode; highway-v0 with 50 vehicles has about 300
MAX_SEED: Final = 2**63
_FIELDS: Final = ("functional", "traffic", "highway-env", "config", "seed", "draws")

Draws = tuple[tuple[str, tuple[float, ...]], ...]


def config_text(config: Mapping[str, Any]) -> str:
    """Return a configuration as JSON with sorted keys, so that equal configurations give equal texts.

    Arrays and numbers of numpy become lists and plain numbers.

    Raises:
        InputError: if a value cannot be stored as JSON.
    """
    try:
        return json.dumps(config, sort_keys=True, separators=(",", ":"), allow_nan=False, default=_plain)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"The environment's configuration cannot be stored: {error}; use texts, numbers, lists and mappings in it"
        ) from None


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"it contains {brief(value)}")


def sorted_draws(draws: Mapping[str, Sequence[float]]) -> Draws:
    """Return draws by name in the form in which a `DrawnScenario` keeps them."""
    return tuple((name, tuple(draws[name])) for name in sorted(draws))


@dataclass(frozen=True, slots=True)
class Setup:
    """An environment in one configuration, whose draws mean the same in every episode.

    Attributes:
        env: gymnasium id of the environment, such as "highway-fast-v0", or "module:id".
        config: highway-env's whole configuration of the environment as JSON, with sorted keys.
        traffic: kind of traffic: "default" is the environment's own; "wide" is `behavexplor.envs.highway.wide_traffic`.
        highway_env: version of highway-env.
    """

    env: str
    config: str
    traffic: Traffic
    highway_env: str

    @property
    def scene(self) -> tuple[str, str, str, str]:
        """What is the same for all drivers: this setup without the keys that a driver declares."""
        return self.env, config_text(self.scene_config), self.traffic, self.highway_env

    @property
    def scene_config(self) -> dict[str, Any]:
        """The configuration without the keys that a driver declares."""
        return {key: value for key, value in json.loads(self.config).items() if key not in DECLARED}

    def difference(self, other: "Setup") -> str | None:
        """Return how another setup differs from this one, for an error message; None if they are equal."""
        for name in ("env", "traffic", "highway_env"):
            if getattr(self, name) != getattr(other, name):
                return f"{name.replace('_', '-')} is {getattr(other, name)!r}, not {getattr(self, name)!r}"
        own, others = json.loads(self.config), json.loads(other.config)
        for key in sorted({*own, *others}):
            if own.get(key) != others.get(key):
                return f"{key!r} in its configuration is {brief(others.get(key))}, not {brief(own.get(key))}"
        return None


def _are_finite_floats(values: list[float]) -> bool:
    """Return whether all are finite floats, quickly. It is also False if their sum overflows."""
    return set(map(type, values)) <= {float} and math.isfinite(sum(values))


@dataclass(frozen=True, slots=True)
class DrawnScenario:
    """A concrete scenario of a highway-env environment.

    Attributes:
        setup: the environment and its configuration.
        seed: seed of the draws that are not given.
        draws: standard forms of the given draws, by the name of the call that makes them; see
            `behavexplor.envs.highway.generator`. They are sorted by name.

    Raises:
        InputError: if the seed or a draw is out of range.
    """

    setup: Setup
    seed: int
    draws: Draws

    has_original = True  # the environment is highway-env's
    npcs = ()  # no vehicle is scripted: all drive themselves

    def __post_init__(self) -> None:
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or not 0 <= self.seed < MAX_SEED:
            raise InputError(f"seed: expected a whole number from 0 to 2^63 - 1, got {brief(self.seed)}")
        every = list(chain.from_iterable(values for _, values in self.draws))
        if len(every) > MAX_DRAWS:
            raise InputError(f"draws: at most {MAX_DRAWS} can be given")
        if _are_finite_floats(every):
            return  # nearly always; the loop below also accepts whole numbers, and names what is wrong
        for name, values in self.draws:
            for i, value in enumerate(values):
                if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                    raise InputError(f"draws[{name!r}][{i}]: expected a finite number, got {brief(value)}")

    @property
    def meta_actions(self) -> tuple[str, ...]:
        """The names of the driver's actions by index, if they are highway-env's meta-actions; otherwise nothing."""
        action = json.loads(self.setup.config).get("action", {})
        if action.get("type") != "DiscreteMetaAction":
            return ()
        along, across = (action.get(name, True) for name in ("longitudinal", "lateral"))
        if along and across:
            return MANEUVERS
        return ("SLOWER", "IDLE", "FASTER") if along else MANEUVERS[:3]

    @property
    def functional(self) -> str:
        """Name of the environment."""
        return self.setup.env

    @property
    def conditions(self) -> dict[str, Any]:
        """The configuration and the kind of traffic of the environment."""
        return {"env_config": json.loads(self.setup.config), "traffic": self.setup.traffic}

    @property
    def scene_config(self) -> dict[str, Any]:
        """The configuration without the keys that a driver declares."""
        return self.setup.scene_config

    @property
    def scene(self) -> tuple[Any, ...]:
        """What is the same in the scenario for every driver."""
        return *self.setup.scene, self.seed, self.draws

    def to_dict(self) -> dict[str, Any]:
        """Return the scenario as JSON values."""
        return {
            "functional": self.setup.env,
            "traffic": self.setup.traffic,
            "highway-env": self.setup.highway_env,
            "config": json.loads(self.setup.config),
            "seed": self.seed,
            "draws": {name: list(values) for name, values in self.draws},
        }

    def to_json(self) -> str:
        """Return the scenario as one line of JSON. `behavexplor.data.scenario.parse_scenario` restores it exactly."""
        return json.dumps(self.to_dict(), separators=(",", ":"))

    @classmethod
    def from_dict(cls, value: object) -> Self:
        """Create a scenario from JSON values, as returned by `to_dict`.

        Raises:
            InputError: if a field is missing, unknown or wrong; the message names it.
        """
        fields = object_fields("the scenario", value, _FIELDS)
        draws = fields["draws"]
        if not isinstance(fields["config"], dict):
            raise InputError(f"config: expected highway-env's configuration, got {brief(fields['config'])}")
        if not isinstance(draws, dict) or not all(isinstance(values, list) for values in draws.values()):
            raise InputError(f"draws: expected lists of numbers by name, got {brief(draws)}")
        if fields["traffic"] not in TRAFFIC:
            raise InputError(f"traffic: expected {' or '.join(TRAFFIC)}, got {brief(fields['traffic'])}")
        for name in ("functional", "highway-env"):
            if not isinstance(fields[name], str):
                raise InputError(f"{name}: expected a text, got {brief(fields[name])}")
        setup = Setup(fields["functional"], config_text(fields["config"]), fields["traffic"], fields["highway-env"])
        return cls(setup, fields["seed"], sorted_draws(draws))
