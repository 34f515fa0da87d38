"""Concrete scenarios, in which all values are fixed, and logical scenarios: the sets from which they are drawn.

There are two kinds of both: scripted vehicles on one of this package's roads (`behavexplor.data.scripted` and
`scripted_logical`), and the random draws of a highway-env environment (`drawn_scenario` and `drawn_logical`).
"""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.drawn_scenario import DrawnScenario
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scripted import NPC, ScriptedScenario
from behavexplor.data.trace import Trace
from behavexplor.data.untrusted import parse_json, read_file
from behavexplor.errors import InputError

MAX_KEEP_PROBABILITY: Final = 0.95  # with greater values, almost every draw would leave a scenario unchanged
MIN_SIGMA: Final = 1e-6  # smaller noise would leave a scenario unchanged


class Scenario(Protocol):
    """A concrete scenario: a frozen value, which can be compared, hashed and stored."""

    @property
    def functional(self) -> str:
        """Name of the functional scenario, or of the highway-env environment."""

    @property
    def npcs(self) -> tuple[NPC, ...]:
        """The scripted vehicles; none where all vehicles drive themselves."""

    @property
    def has_original(self) -> bool:
        """Whether the scenario belongs to one of highway-env's environments, so that highway-env itself can run it."""

    @property
    def meta_actions(self) -> tuple[str, ...]:
        """The names of the driver's actions by index, if they are highway-env's meta-actions; otherwise nothing."""

    @property
    def conditions(self) -> Mapping[str, Any]:
        """The fields of a `behavexplor.data.target.Target` that the scenario itself states."""

    @property
    def scene_config(self) -> Mapping[str, Any]:
        """The configuration of the environment that the scenario itself states, but for what a driver declares."""

    @property
    def scene(self) -> Hashable:
        """What is the same in the scenario for every driver."""

    def to_dict(self) -> dict[str, Any]:
        """Return the scenario as JSON values, from which `read_scenario` restores it exactly."""

    def to_json(self) -> str:
        """Return the scenario as one line of JSON, from which `parse_scenario` restores it exactly."""

    def __hash__(self) -> int: ...


def read_scenario(value: object) -> Scenario:
    """Create a scenario of either kind from JSON values, as returned by `to_dict`.

    Raises:
        InputError: if a field is missing, unknown or wrong; the message names it.
    """
    if isinstance(value, dict) and "draws" in value:
        return DrawnScenario.from_dict(value)
    return ScriptedScenario.from_dict(value)


def parse_scenario(text: str) -> Scenario:
    """Create a scenario of either kind from JSON, as returned by `to_json`.

    Raises:
        InputError: if the text is too long or not JSON, or a field is wrong; the message names the field.
    """
    return read_scenario(parse_json(text, "a scenario"))


def read_scenarios(path: Path, logical: "LogicalScenario") -> list[Scenario]:
    """Return the scenarios of a file, one as JSON in each line, as scenarios of a logical scenario.

    They may have been found with another driver.

    Raises:
        InputError: if the file cannot be read, or a scenario is not valid; the message names the line.
    """
    try:
        lines = read_file(path).decode().splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"The scenarios in {path} cannot be read: {error}") from None
    scenarios = []
    for number, line in enumerate(lines, 1):
        try:
            scenarios.append(logical.adopted(parse_scenario(line)))
        except InputError as error:
            raise InputError(f"{path}, line {number}: {error}") from None
    return scenarios


Value = float | str | None  # of a part of a scenario


class Part(NamedTuple):
    """A vehicle, or another part of a scene, as a list of values, which minimization removes or makes plain.

    Attributes:
        label: what stays as it is as long as the part is there, such as the route of a vehicle.
        values: the values of the part; None stands for a plain value, such as the speed of the waypoint before, or the
            median of a draw.
    """

    label: str
    values: tuple[Value, ...]

    @property
    def free(self) -> int:
        """Number of values that are not plain."""
        return sum(value is not None for value in self.values)


Parts = tuple[Part, ...]


class Size(NamedTuple):
    """The size of a scenario.

    Attributes:
        parts: number of vehicles, or of parts with a value that is not plain where parts cannot be removed.
        values: number of values that are not plain.
    """

    parts: int
    values: int


class Mutations(NamedTuple):
    """Names of the two mutations of a kind of scenario, which are the origins of mutants.

    Attributes:
        little: the mutation by noise.
        much: the mutation by new draws.
    """

    little: str
    much: str


@dataclass(frozen=True)
class Noise:
    """The size of a small mutation.

    Attributes:
        keep_probability: epsilon, the probability that a vehicle stays unchanged.
        sigma_position: standard deviation of the noise on a scripted vehicle's positions [m].
        sigma_speed: standard deviation of the noise on a scripted vehicle's speeds [m/s].
        sigma_draw: standard deviation of the noise on a draw of a highway-env environment, as a share of its range.
        point_keep_probability: probability that a waypoint, or a draw, of a chosen vehicle stays unchanged.
    """

    keep_probability: float
    sigma_position: float
    sigma_speed: float
    sigma_draw: float
    point_keep_probability: float = 0.0


class Encoding(Protocol):
    """An encoding of concrete scenarios as points of [0, 1]^n. Every point is a valid scenario.

    A vector has one block of genes for each vehicle. Uniform genes give the distribution of the sampler.

    Attributes:
        n_blocks: number of blocks in a vector.
        n_genes: number of genes in a block.
    """

    n_blocks: int
    n_genes: int

    @property
    def size(self) -> int:
        """Length n of a vector."""

    def decode(self, vector: Floats) -> Any:
        """Return the scenario of a vector, shape (n,). Values beyond [0, 1] are clipped.

        Raises:
            InputError: if the vector has another shape, or is not finite.
        """

    def encode(self, scenario: Any) -> Floats:
        """Return the vector of a scenario, shape (n,). `decode` restores the scenario to six decimals."""

    def features(self, vectors: Floats) -> Floats:
        """Return features for distances and regression of vectors, shape (k, n)."""

    def draw_gene(self, rng: np.random.Generator) -> int:
        """Draw the index of one gene of a block, which a small change of one vehicle replaces."""


def draws(seed: int, number: int, *purpose: int) -> np.random.Generator:
    """Return the random number generator of one candidate. It depends only on the arguments.

    Args:
        seed: seed of the campaign.
        number: number of the candidate.
        purpose: integers that make separate generators for the same candidate, one for each purpose.
    """
    return np.random.default_rng([seed, number, *purpose])


class LogicalScenario(Protocol):
    """A set of concrete scenarios. The scenarios that its methods take must be valid in it."""

    @property
    def name(self) -> str:
        """Name of the functional scenario, or of the highway-env environment."""

    @property
    def roadmap(self) -> RoadMap | None:
        """The map; None for a highway-env environment, whose road is its own."""

    @property
    def has_original(self) -> bool:
        """Whether this is one of highway-env's environments, so that highway-env itself can also run the scenarios."""

    @property
    def config(self) -> Mapping[str, Any]:
        """The configuration of the environment, if the scenarios belong to one; else nothing."""

    @property
    def mutations(self) -> Mutations:
        """Names of the mutations."""

    @property
    def encoding(self) -> Encoding:
        """The encoding of scenarios as vectors.

        Raises:
            InputError: if there is nothing that could be varied.
        """

    @property
    def line_kinds(self) -> tuple[str, ...]:
        """The kinds of the illegal lines in a trace, one for each line."""

    def to_json(self) -> str:
        """Return the set as JSON if it depends on the driver; otherwise nothing, because its name says all."""

    def check(self, scenario: Any) -> None:
        """Check that a scenario belongs to the set.

        Raises:
            InputError: if it does not; the message names the field that is wrong.
        """

    def adopted(self, scenario: Any) -> Scenario:
        """Return the scenario of another driver as one of this set, in which everything but the driver is the same.

        Raises:
            InputError: if there is none; the message names the difference.
        """

    def sample(self, rng: np.random.Generator) -> Scenario:
        """Draw a scenario."""

    def pass_over(self, rng: np.random.Generator) -> None:
        """Advance the generator as `sample` does, without making a scenario."""

    def mutate_little(self, scenario: Any, rng: np.random.Generator, noise: Noise) -> Scenario:
        """Return a mutant of a scenario by noise on some of its vehicles.

        Raises:
            InputError: if no mutant was found.
        """

    def mutate_much(self, scenario: Any, rng: np.random.Generator, keep_probability: float) -> Scenario:
        """Return a mutant of a scenario by new draws for some of its vehicles.

        Raises:
            InputError: if no mutant was found.
        """

    def first_frame(self, scenario: Any, end: str) -> Trace:
        """Return the trace of an episode that ended before any vehicle moved. `end` is one of the trace's `ENDS`."""

    def describe(self, scenario: Any) -> str:
        """Return a short description of a scenario for people."""

    @property
    def removable(self) -> bool:
        """Whether a scenario is valid without some of its parts."""

    def parts(self, scenario: Any) -> Parts:
        """Return the parts of a scenario, from which `with_parts` makes it again."""

    def with_parts(self, scenario: Any, parts: Parts) -> Scenario:
        """Return a scenario with other parts.

        Raises:
            InputError: if such a scenario is not in the set.
        """
