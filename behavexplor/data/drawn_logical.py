"""Logical scenarios of highway-env environments: all the draws that an environment can make in one configuration."""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Final, Self

import numpy as np
import scipy
from numpy.typing import NDArray

from behavexplor.data.array_types import Bools, Floats
from behavexplor.data.drawn_scenario import DrawnScenario, Setup
from behavexplor.data.scenario import Mutations, Noise, Part, Parts
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError

UNIFORM, NORMAL = "uniform", "normal"  # kinds of draws: a number in [0, 1), or a standard normal number
SEEDS: Final = 2**32  # number of seeds of sampled scenarios
PLAIN: Final = 0.5  # share of the median
_MUTATIONS: Final = Mutations("noise", "new draws")
_UNUSED: Final = 0.5  # gene that stands for no draw
_DIGITS: Final = 9  # decimals of decoded draws, so that copies of a scenario are equal to it
_EDGE: Final = 1e-12  # least distance of a normal draw's share from 0 and 1
_ATTEMPTS: Final = 1000


@dataclass(frozen=True, slots=True)
class Draw:
    """A random draw of an environment."""

    name: str  # name of the call that makes it; see `behavexplor.envs.highway.generator`
    position: int  # its position among the draws of that call
    kind: str  # UNIFORM or NORMAL
    block: int  # index of the vehicle, or other part of the scene, to which it belongs


@dataclass(frozen=True)
class DrawnLogicalScenario:
    """The draws of a highway-env environment; see `behavexplor.data.scenario.LogicalScenario`.

    The standard form of a draw is a number in [0, 1) or a standard normal number, by its kind. A draw that is not among
    `draws`, because it is rarely made, is made from the scenario's seed.
    """

    setup: Setup  # the environment and its configuration
    draws: tuple[Draw, ...]  # the draws, sorted by name and position. The positions of each name are 0, 1, 2, ...

    roadmap: None = None
    has_original: bool = True
    line_kinds: tuple[str, ...] = ()
    mutations: Mutations = _MUTATIONS
    removable: bool = False  # the environment decides how many vehicles there are

    def to_json(self) -> str:
        """Return the logical scenario as JSON, from which `from_json` restores it."""
        draws = [[draw.name, draw.position, draw.kind, draw.block] for draw in self.draws]
        return json.dumps({"setup": asdict(self.setup), "draws": draws})

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return the logical scenario that `to_json` wrote."""
        values = json.loads(text)
        return cls(Setup(**values["setup"]), tuple(Draw(*draw) for draw in values["draws"]))

    @property
    def name(self) -> str:
        """Name of the environment."""
        return self.setup.env

    @property
    def config(self) -> dict[str, Any]:
        """The whole configuration of the environment."""
        return dict(json.loads(self.setup.config))

    @cached_property
    def blocks(self) -> tuple[NDArray[np.intp], ...]:
        """Indices of the draws in each block."""
        block = np.array([draw.block for draw in self.draws])
        return tuple(np.flatnonzero(block == i) for i in np.unique(block))

    @cached_property
    def encoding(self) -> "DrawnEncoding":
        """The encoding of scenarios as vectors."""
        return DrawnEncoding(self)

    def check(self, scenario: Any) -> None:
        """Check that a scenario belongs to this environment and configuration."""
        if not isinstance(scenario, DrawnScenario):
            raise InputError(f"functional: this is a scenario of {scenario.functional!r}, not of {self.name!r}")
        if scenario.setup != self.setup:
            difference = self.setup.difference(scenario.setup) or "it differs"
            raise InputError(f"The scenario was drawn in another environment: {difference}")
        given = dict(scenario.draws)
        for draw in self.draws:
            values = given.get(draw.name, ())
            if draw.kind == UNIFORM and draw.position < len(values) and not 0 <= values[draw.position] < 1:
                value = values[draw.position]
                raise InputError(f"draws[{draw.name!r}][{draw.position}]: {value} is not in [0, 1)")

    def adopted(self, scenario: Any) -> DrawnScenario:
        """Return the scenario of another driver as one of this set: the same draws in the same scene."""
        same_scene = isinstance(scenario, DrawnScenario) and scenario.setup.scene == self.setup.scene
        adopted: DrawnScenario = replace(scenario, setup=self.setup) if same_scene else scenario
        self.check(adopted)
        return adopted

    def sample(self, rng: np.random.Generator) -> DrawnScenario:
        """Draw a scenario with the environment's own distribution."""
        return self.scenario(int(rng.integers(SEEDS)), self._fresh(rng))

    def pass_over(self, rng: np.random.Generator) -> None:
        """Advance the generator as `sample` does, without making a scenario."""
        rng.integers(SEEDS)
        self._fresh(rng)

    def scenario(self, seed: int, forms: Floats) -> DrawnScenario:
        """Return the scenario with the given standard forms of its draws, shape (n_draws,)."""
        values = forms.tolist()
        return DrawnScenario(self.setup, seed, tuple((name, tuple(values[place])) for name, place in self._places))

    @cached_property
    def _places(self) -> tuple[tuple[str, slice], ...]:
        """The names of the draws in their order, each with the slice of `draws` that has it."""
        places = []
        begin = 0
        for name, count in Counter(draw.name for draw in self.draws).items():
            places.append((name, slice(begin, begin + count)))
            begin += count
        return tuple(places)

    def forms(self, scenario: DrawnScenario) -> Floats:
        """Return the standard forms of a scenario's draws, shape (n_draws,), at their median where it has none."""
        given: Mapping[str, Sequence[float]] = dict(scenario.draws)
        return np.array(
            [
                given[draw.name][draw.position]
                if draw.position < len(given.get(draw.name, ()))
                else _plain_form(draw.kind)
                for draw in self.draws
            ]
        )

    def mutate_little(self, scenario: DrawnScenario, rng: np.random.Generator, noise: Noise) -> DrawnScenario:
        """Return a mutant by Gaussian noise on the shares of some vehicles' draws, reflected at 0 and 1."""

        def changed(forms: Floats) -> Floats:
            shares = self.shares(forms)
            moved = rng.random(len(shares)) >= noise.point_keep_probability
            return self.of_shares(_reflected(shares + moved * rng.normal(0.0, noise.sigma_draw, len(shares))))

        return self._mutate(scenario, rng, noise.keep_probability, changed, reseed=False)

    def mutate_much(self, scenario: DrawnScenario, rng: np.random.Generator, keep_probability: float) -> DrawnScenario:
        """Return a mutant by new draws for some vehicles."""
        return self._mutate(scenario, rng, keep_probability, lambda _: self._fresh(rng), reseed=True)

    def _mutate(
        self,
        scenario: DrawnScenario,
        rng: np.random.Generator,
        keep_probability: float,
        change: Callable[[Floats], Floats],
        *,
        reseed: bool,
    ) -> DrawnScenario:
        """Change the draws of each block with probability 1 - `keep_probability`; with `reseed`, the seed as well."""
        for _ in range(_ATTEMPTS):
            forms = self.forms(scenario)
            new, stays = change(forms), rng.random(len(self.blocks) + 1) < keep_probability
            for block, stay in zip(self.blocks, stays[:-1], strict=True):
                if not stay:
                    forms[block] = new[block]
            seed = int(rng.integers(SEEDS)) if reseed and not stays[-1] else scenario.seed
            mutant = self.scenario(seed, forms)
            if mutant != scenario:
                return mutant
        raise InputError(f"None of {_ATTEMPTS} mutations changed a scenario of {self.name}")

    def shares(self, forms: Floats) -> Floats:
        """Return the shares in [0, 1] that stand for standard forms: quantiles for normal draws."""
        return np.where(self._is_normal, scipy.special.ndtr(forms), forms)

    def of_shares(self, shares: Floats) -> Floats:
        """Return the standard forms of shares, rounded so that `shares` and then this method give equal forms again."""
        uniform = np.minimum(np.round(shares, _DIGITS), 1 - 10.0**-_DIGITS)
        normal = np.round(scipy.special.ndtri(np.clip(shares, _EDGE, 1 - _EDGE)), _DIGITS)
        return np.where(self._is_normal, normal, uniform)

    @cached_property
    def _is_normal(self) -> Bools:
        return np.array([draw.kind == NORMAL for draw in self.draws], dtype=bool)

    def _fresh(self, rng: np.random.Generator) -> Floats:
        n = len(self.draws)
        return np.where(self._is_normal, rng.standard_normal(n), rng.random(n))

    def first_frame(self, scenario: DrawnScenario, end: str) -> Trace:  # noqa: ARG002 - the draws do not tell the place
        """Return the trace of an episode that ended before any vehicle moved.

        Only the environment knows where the vehicles are. So the trace has the ego alone, at the origin.
        """
        return Trace(
            time=np.zeros(1),
            position=np.zeros((1, 1, 2)),
            heading=np.zeros((1, 1)),
            velocity=np.zeros((1, 1, 2)),
            size=np.array([[5.0, 2.0]]),
            actions=np.zeros((0, 1)),
            action_frame=np.zeros(0, dtype=np.int64),
            route=np.array([[0.0, 0.0], [1.0, 0.0]]),
            destination=np.array([1.0, 0.0]),
            illegal_lines=np.zeros((0, 2, 2)),
            end=end,
            signals={"crashed": np.zeros(1)},
        )

    def describe(self, scenario: DrawnScenario) -> str:
        """Return a short description: the number of draws, that of the parts to which they belong, and the traffic."""
        count = sum(len(values) for _, values in scenario.draws)
        return f"{count} draws in {len(self.blocks)} parts, {self.setup.traffic} traffic"

    def parts(self, scenario: DrawnScenario) -> Parts:
        """Return the blocks of a scenario's draws as parts. A draw is plain at its median."""
        forms, plain = self.forms(scenario).tolist(), self._plain_forms.tolist()
        values = [None if form == median else form for form, median in zip(forms, plain, strict=True)]
        return tuple(Part(str(i), tuple(values[j] for j in block)) for i, block in enumerate(self.blocks))

    def with_parts(self, scenario: DrawnScenario, parts: Parts) -> DrawnScenario:
        """Return a scenario with other draws."""
        forms = self._plain_forms.copy()
        for block, part in zip(self.blocks, parts, strict=True):
            for j, value in zip(block, part.values, strict=True):
                if value is not None:
                    forms[j] = value
        changed = replace(scenario, draws=self.scenario(scenario.seed, forms).draws)
        self.check(changed)
        return changed

    @cached_property
    def _plain_forms(self) -> Floats:
        return np.array([_plain_form(draw.kind) for draw in self.draws])


class DrawnEncoding:
    """Encoding of a highway-env environment's draws as points of [0, 1]^n; see `behavexplor.data.scenario.Encoding`.

    The last block has one gene, the seed. A gene that a block does not need stands for nothing.

    Raises:
        InputError: if the environment makes no draws.
    """

    def __init__(self, logical: DrawnLogicalScenario) -> None:
        if not logical.draws:
            raise InputError(f"{logical.name}: the environment makes no random draws, so there is nothing to search")
        self.logical = logical
        self.n_blocks = len(logical.blocks) + 1
        self.n_genes = max(len(block) for block in logical.blocks)
        places = [row * self.n_genes + np.arange(len(block)) for row, block in enumerate(logical.blocks)]
        self._place = np.zeros(len(logical.draws), dtype=np.intp)  # gene of each draw
        self._place[np.concatenate(logical.blocks)] = np.concatenate(places)

    @property
    def size(self) -> int:
        """Length n of a vector."""
        return self.n_blocks * self.n_genes

    def decode(self, vector: Floats) -> DrawnScenario:
        """Return the scenario of a vector, shape (n,). Values beyond [0, 1] are clipped."""
        vector = np.asarray(vector, dtype=np.float64)
        if vector.shape != (self.size,) or not np.isfinite(vector).all():
            raise InputError(f"vector: expected {self.size} finite numbers, got shape {vector.shape}")
        genes = np.clip(vector, 0.0, 1.0)
        seed = min(int(genes[self._seed_gene] * SEEDS), SEEDS - 1)
        return self.logical.scenario(seed, self.logical.of_shares(genes[self._place]))

    def encode(self, scenario: DrawnScenario) -> Floats:
        """Return the vector of a scenario, shape (n,). `decode` restores its draws to nine decimals."""
        vector = np.full(self.size, _UNUSED)
        vector[self._place] = self.logical.shares(self.logical.forms(scenario))
        vector[self._seed_gene] = (scenario.seed % SEEDS) / SEEDS
        return vector

    def features(self, vectors: Floats) -> Floats:
        """Return features for distances and regression of vectors, shape (k, n): the shares of the draws."""
        return np.asarray(vectors[:, self._place])

    def draw_gene(self, rng: np.random.Generator) -> int:
        """Draw the index of any gene of a block."""
        return int(rng.integers(self.n_genes))

    @property
    def _seed_gene(self) -> int:
        return (self.n_blocks - 1) * self.n_genes


def _plain_form(kind: str) -> float:
    """Return the median of a kind of draw."""
    return 0.0 if kind == NORMAL else PLAIN


def _reflected(shares: Floats) -> Floats:
    """Return numbers mirrored at 0 and 1 until they lie between them."""
    return np.abs((shares + 1.0) % 2.0 - 1.0)
