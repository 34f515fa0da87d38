"""BehAVExplor: search guided by the novelty of behaviors and by their violation degrees (paper Algorithm 1).

In this order: energies (section 3.3), the corpus, the assessment of an execution, and the search.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from behavexplor.behavior.miner import Behavior, BehaviorMiner, MinerOptions
from behavexplor.behavior.novelty import NOVELTY_THRESHOLD
from behavexplor.data.array_types import Floats
from behavexplor.data.geometry import point_box_distance
from behavexplor.data.roadmap import CURB, DOUBLE_YELLOW
from behavexplor.data.scenario import MAX_KEEP_PROBABILITY, MIN_SIGMA, LogicalScenario, Noise, Scenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.fuzz.search import INITIAL, MAX_FAILED_INITIAL, Candidate, draws, nothing_to_mutate
from behavexplor.judge.specs import Collision, Lines, Verdict, final_distance

SELECTION_CHANGE = -0.05  # dE_S, the decay with each selection
GAMMA = 1e-5  # gamma of equation 16, against division by zero
_BENIGN_SHARE = 0.1  # a passed mutant costs less energy than a failed one adds


def failure_change(failed: bool, n_failed: int, n_passed: int) -> float:
    """Compute dE_F of a parent (paper equation 15): how its energy changes when its last mutant `failed` or passed.

    `n_failed` (#F) of its mutants failed and `n_passed` (#NF) did not, including the last one.
    """
    if failed:
        return n_failed / (n_passed + n_failed)
    return -_BENIGN_SHARE * n_passed / (n_passed + n_failed)


def degree_change(parent_degree: float, degree: float, distance: float, *, bounded: bool, gamma: float) -> float:
    """Compute dE_V of a mutant and its parent (paper equation 16).

    `parent_degree` and `degree` are their violation degrees O_s and O_s' [m]; `distance` is dis(s', s), the distance of
    their behaviors, in [0, 1]; `gamma` prevents division by zero. Unless `bounded` by tanh, a single mutant at distance
    1 changes the energy by 1e5 per meter with the default gamma, and the selection never recovers from it.
    """
    change = (parent_degree - degree) / (1 - distance + gamma)
    return math.tanh(change) if bounded else change


def selection_probabilities(energies: Floats) -> Floats:
    """Compute p_i of each testcase (paper equation 18), normalized over the positive energies so that they sum to 1.

    Energies and probabilities have the shape (n,). If no energy is positive, all testcases are equally likely.
    """
    weights = np.maximum(energies, 0.0)
    total = weights.sum()
    if not total > 0:
        return np.full(len(weights), 1 / len(weights))
    return np.asarray(weights / total)


@dataclass(slots=True)
class Testcase:
    """A kept scenario with its record. The paper calls it a seed."""

    __test__ = False  # keeps pytest from collecting the class

    number: int  # number of the candidate that became this testcase
    scenario: Scenario
    degree: float  # violation degree of its execution, the paper's O [m]
    behavior: int  # index of its behavior in the miner
    n_failed: int = 0  # number of its mutants that failed, the paper's #F
    n_passed: int = 0  # number of its mutants that did not fail, the paper's #NF


class Corpus:
    """Testcases in the order in which they were kept, with their energies. Failures never become testcases."""

    def __init__(self) -> None:
        self._testcases: list[Testcase] = []
        self._places: dict[int, int] = {}  # by the number of the candidate
        self._energies = np.zeros(16)  # grows by doubling, so that no execution pays for the whole corpus

    def __len__(self) -> int:
        return len(self._testcases)

    def __iter__(self) -> Iterator[Testcase]:
        return iter(self._testcases)

    def __getitem__(self, number: int) -> Testcase:
        """Return the testcase with the given candidate number."""
        return self._testcases[self._places[number]]

    @property
    def energies(self) -> Floats:
        """The paper's E of each testcase, in their order, shape (len(self),)."""
        return self._energies[: len(self)]

    def add(self, testcase: Testcase, energy: float) -> None:
        """Add a testcase with its initial energy."""
        if len(self) == len(self._energies):
            self._energies = np.concatenate([self._energies, np.zeros(len(self))])
        self._places[testcase.number] = len(self)
        self._testcases.append(testcase)
        self.set_energy(testcase.number, energy)

    def energy(self, number: int) -> float:
        """Return the energy of the testcase with the given candidate number."""
        return float(self._energies[self._places[number]])

    def set_energy(self, number: int, energy: float) -> None:
        """Change the energy of the testcase with the given candidate number."""
        self._energies[self._places[number]] = energy

    def select(self, rng: np.random.Generator, *, uniform: bool = False) -> Testcase:
        """Draw a testcase by energy (paper equation 18) or uniformly."""
        energies = np.zeros(len(self)) if uniform else self.energies
        return self._testcases[rng.choice(len(self), p=selection_probabilities(energies))]


MAX_SHRINK = 1.0  # [m]; no vehicle is that narrow
_REACH = 10.0  # distance to the destination at which its term saturates [m], as in the paper's section 3.2.2


@validated
class AssessmentOptions:
    """Options of the assessment that guides a search. With the defaults, it equals the recorded verdict.

    Other values give the figures that guide the authors' released program, which differ from the paper's formulas.
    """

    # violation degree. "sum" is the sum of the specs' degrees, the paper's O. "clipped" is the mean of the terms D_b,
    # D_yellow, D_curb (at most 1 m each) and 1 - min(D, 10) / 10, as released.
    degree: Literal["sum", "clipped"] = "sum"
    # length by which every vehicle is made shorter and narrower [m], for the clipped terms and for a distance from the
    # ego's box; twice the margin on each of its sides
    box_shrink: Annotated[float, between(0, MAX_SHRINK)] = 0.0
    # part of the ego whose distance from the destination counts: its "center", or its "box", within which the distance
    # is 0
    destination_from: Literal["center", "box"] = "center"
    # distance from the destination beyond which the end of an execution counts as a failure [m]; None for the verdict
    # of the spec
    destination_threshold: Annotated[float, between(0)] | None = None
    # growth of the distance to the destination within one frame beyond which an execution counts as a failure and its
    # trace is cut off [m]; None for no such limit
    retreat: Annotated[float, between(0)] | None = None


@dataclass(frozen=True)
class Assessment:
    """Violation degree and failure as a search sees them; records and reports have those of the verdict."""

    trace: Trace  # the trace, up to its cut if it was cut off
    degree: float  # violation degree, the paper's O. A lower degree is nearer to a violation.
    failed: bool  # whether the execution counts as a failure


def assess(trace: Trace, verdict: Verdict, line_kinds: Sequence[str], options: AssessmentOptions) -> Assessment:
    """Assess an execution. `line_kinds` has the kind of each illegal line of the trace, `CURB` or `DOUBLE_YELLOW`."""
    seen = _until_retreat(trace, options)
    degree = verdict.degree if options.degree == "sum" else _clipped_degree(seen, line_kinds, options)
    failed = verdict.failed
    if options.destination_threshold is not None:
        others = [name for name in verdict.violated if name != "destination"]
        failed = bool(others) or _final_distance(seen, options) > options.destination_threshold
    return Assessment(seen, degree, failed or seen is not trace)


def _distances(trace: Trace, options: AssessmentOptions) -> Floats:
    """Compute the ego's distance from its destination in each frame, shape (T,) [m]."""
    position, heading = trace.position[:, 0], trace.heading[:, 0]
    size = trace.size[0] - options.box_shrink if options.destination_from == "box" else np.zeros(2)
    return point_box_distance(trace.destination, position, heading, size)


def _final_distance(trace: Trace, options: AssessmentOptions) -> float:
    return final_distance(trace) if options.destination_from == "center" else float(_distances(trace, options)[-1])


def _until_retreat(trace: Trace, options: AssessmentOptions) -> Trace:
    """Return the trace up to the first frame in which the distance to the destination grew by more than the limit.

    Without such a frame, or without a limit, return the trace itself.
    """
    if options.retreat is None:
        return trace
    growing = np.flatnonzero(np.diff(_distances(trace, options)) > options.retreat)
    if not len(growing):
        return trace
    frames = int(growing[0]) + 2  # keep the frame in which the distance grew
    return trace.until(frames, "timeout")


def _clipped_degree(trace: Trace, line_kinds: Sequence[str], options: AssessmentOptions) -> float:
    """Compute the degree of the option "clipped"."""
    smaller = replace(trace, size=trace.size - options.box_shrink)
    kinds = np.array(line_kinds)
    terms = [Collision().degree(smaller)]
    terms += [
        Lines().degree(replace(smaller, illegal_lines=trace.illegal_lines[kinds == kind]))
        for kind in (DOUBLE_YELLOW, CURB)
    ]
    clipped = [min(term, 1.0) for term in terms]
    return float(np.mean([*clipped, 1 - min(_final_distance(trace, options), _REACH) / _REACH]))


@validated
class BehAVExplorOptions:
    """Options of `BehAVExplor`. The defaults are the paper's configuration (section 4), where it states one.

    Other values of these options give the behavior of the authors' released program and the paper's ablations. The
    presets are in `configs/`, and docs/methods.md has a table of them.
    """

    initial_corpus: Annotated[int, between(1)] = 4  # scenarios before the first mutation; not stated in the paper
    initial_energy: float = 1.0  # E of the initial testcases
    # source of novelty. "measured" is the novelty of a mutant's behavior. "random" is a control in which novelty and
    # distance are drawn from [0, 1]. "none" is the paper's w/o BG.
    novelty: Literal["measured", "random", "none"] = "measured"
    # theta_c: a behavior is novel if it is farther than this from all known ones
    novelty_threshold: Annotated[float, between(0, 1)] = NOVELTY_THRESHOLD
    # Y, the testcases whose behaviors are known: all that were "kept", or only initial and "novel" ones
    known: Literal["kept", "novel"] = "kept"
    selection: Literal["energy", "uniform"] = "energy"  # how a testcase is drawn; "uniform" is the paper's w/o Energy
    mutation: Literal["energy", "random"] = "energy"  # how a mutation is chosen; "random" is the paper's w/o Energy
    waypoint_share: Annotated[float, between(0, 1)] = 0.5  # probability of waypoint mutation, if mutations are random
    waypoint_energy: float = 0.5  # theta_e: testcases with more energy get a waypoint mutation, others a route mutation
    # epsilon of waypoint mutation, the probability that an NPC stays unchanged
    waypoint_keep_probability: Annotated[float, between(0, MAX_KEEP_PROBABILITY)] = 0.5
    route_keep_probability: Annotated[float, between(0, MAX_KEEP_PROBABILITY)] = 0.5  # that of route mutation
    # probability that a waypoint of a changed NPC stays unchanged
    point_keep_probability: Annotated[float, between(0, MAX_KEEP_PROBABILITY)] = 0.0
    sigma_position: Annotated[float, between(MIN_SIGMA)] = 12.0  # standard deviation of waypoint mutation [m]
    sigma_speed: Annotated[float, between(MIN_SIGMA)] = 6.0  # standard deviation of waypoint mutation [m/s]
    # in highway-env environments, the standard deviation of the small mutation of a draw, as a share of the draw's
    # range
    sigma_draw: Annotated[float, between(MIN_SIGMA, 1)] = 0.1
    failure_weight: float = 0.5  # w_1, weight of the failure frequency
    degree_weight: float = 0.5  # w_2, weight of the change of the violation degree
    selection_weight: float = 1.0  # w_3, weight of the selection frequency
    # energy that a parent loses with each route mutation in place of the three terms. The mutant then counts neither as
    # failed nor as passed. None for the three terms, as for any other mutant.
    route_cost: float | None = None
    least_energy: float | None = None  # energy below which no testcase falls; None for no limit
    # initial energy of a kept mutant. "degree-change" is 1 + w_2 dE_V (paper equation 17). "degree-and-novelty" is 1 +
    # dO / 2 + d / 2, with the mutant's gain in degree dO and its novelty d.
    mutant_energy: Literal["degree-change", "degree-and-novelty"] = "degree-change"
    success: Literal["failed", "failed-or-novel"] = "failed"  # mutants that count as failures in the failure frequency
    # the distance d in the denominator 1 - d of the change of the violation degree: the mutant's distance from its
    # "parent", or from the nearest of all "known" behaviors
    degree_distance: Literal["parent", "known"] = "parent"
    bounded: bool = True  # whether the change of the violation degree is bounded by tanh, unlike in the paper
    gamma: Annotated[float, between(1e-12, 1)] = GAMMA  # in the denominator 1 - d + gamma of the change of the degree
    # options for the violation degree and the failure of an execution, as the search sees them
    assessment: AssessmentOptions = field(default_factory=AssessmentOptions)
    miner: MinerOptions = field(default_factory=MinerOptions)  # for abstracting behaviors


_NOT_MINED = -1  # index of a behavior that was not computed
_NOVELTY_DRAWS = 1  # purpose of the draws, to tell them apart from those that made the candidate


class BehAVExplor:
    """Search guided by behavior diversity and violation degrees; energies select testcases and their mutations.

    Initial scenarios are asked for until the initial corpus has been executed and one of its scenarios has passed. With
    many candidates in flight, there are more of them than `initial_corpus`. Those that pass become testcases as well.
    """

    Options: ClassVar[type] = BehAVExplorOptions

    def __init__(self, logical: LogicalScenario, seed: int, options: BehAVExplorOptions) -> None:
        self._logical = logical
        self._seed = seed
        self._options = options
        self._corpus = Corpus()  # Q
        self._miner = BehaviorMiner(options.miner)
        self._known = np.zeros(0, dtype=np.int64)  # Y, as indices of behaviors
        self._asked = 0
        self._ready = False
        self._n_initial = 0
        self._n_novel = 0
        self._n_failed = 0

    def ask(self) -> Candidate:
        """Return an initial scenario, or the mutant of a testcase drawn by energy (Algorithm 1, lines 6-7).

        Raises:
            SearchExhausted: if none of `MAX_FAILED_INITIAL` initial scenarios passed.
        """
        if not self._corpus and self._n_failed >= MAX_FAILED_INITIAL:
            raise nothing_to_mutate(self._n_failed)
        number = self._asked
        rng = draws(self._seed, number)
        self._asked += 1
        if not self._ready:
            return Candidate(number, self._logical.sample(rng), INITIAL, None)
        parent = self._corpus.select(rng, uniform=self._options.selection == "uniform")
        kind = self._kind(parent, rng)
        return Candidate(number, self._mutate(parent, kind, rng), kind, parent.number)

    def _kind(self, parent: Testcase, rng: np.random.Generator) -> str:
        """Choose the mutation of the parent (Algorithm 2, line 3)."""
        little, much = self._logical.mutations  # waypoint and route mutation in scripted scenarios
        if self._options.mutation == "random":
            return little if rng.random() < self._options.waypoint_share else much
        return little if self._corpus.energy(parent.number) > self._options.waypoint_energy else much

    def _mutate(self, parent: Testcase, kind: str, rng: np.random.Generator) -> Scenario:
        """Return a mutant of the parent by a mutation of this kind (Algorithm 2)."""
        options = self._options
        if kind == self._logical.mutations.much:
            return self._logical.mutate_much(parent.scenario, rng, options.route_keep_probability)
        noise = Noise(
            keep_probability=options.waypoint_keep_probability,
            sigma_position=options.sigma_position,
            sigma_speed=options.sigma_speed,
            sigma_draw=options.sigma_draw,
            point_keep_probability=options.point_keep_probability,
        )
        return self._logical.mutate_little(parent.scenario, rng, noise)

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:
        """Learn from an execution (Algorithm 1, lines 9-18).

        Returns:
            For an initial scenario, whether it was `kept`. For a mutant: `novelty`, its distance from the known
            behaviors; whether it is `novel`; its `distance` from its parent; whether it was `kept`; the `parent_energy`
            after the update; and its own `energy` if it was kept.
        """
        assessment = assess(trace, verdict, self._logical.line_kinds, self._options.assessment)
        self._n_failed += assessment.failed
        behavior = self._miner.describe(assessment.trace) if self._options.novelty == "measured" else None
        if candidate.parent is None:
            return self._tell_initial(candidate, behavior, assessment)
        return self._tell_mutant(candidate, self._corpus[candidate.parent], behavior, assessment)

    def _tell_initial(
        self, candidate: Candidate, behavior: Behavior | None, assessment: Assessment
    ) -> Mapping[str, Any]:
        """Learn from an initial scenario. The last one that is awaited ends the initial corpus."""
        self._n_initial += 1
        if not assessment.failed:
            self._keep(candidate, behavior, assessment, self._options.initial_energy, known=True)
        if not self._ready and self._corpus and self._n_initial >= self._options.initial_corpus:
            self._miner.fit()
            self._ready = True
        return {"kept": not assessment.failed}

    def _tell_mutant(
        self, candidate: Candidate, parent: Testcase, behavior: Behavior | None, assessment: Assessment
    ) -> Mapping[str, Any]:
        """Learn from a mutant: change the energy of its parent, and keep it if it is novel or nearer to a violation."""
        options = self._options
        novelty, distance = self._novelty(candidate, parent, behavior)
        novel = novelty > options.novelty_threshold
        kept = not assessment.failed and (novel or assessment.degree < parent.degree)
        compared_distance = distance if options.degree_distance == "parent" else novelty
        degree_term = degree_change(
            parent.degree, assessment.degree, compared_distance, bounded=options.bounded, gamma=options.gamma
        )
        failed = assessment.failed or (novel and options.success == "failed-or-novel")
        parent_energy = self._changed_energy(parent, candidate.origin, degree_term, failed)
        self._corpus.set_energy(parent.number, parent_energy)
        learned = {
            "novelty": novelty,
            "novel": novel,
            "distance": distance,
            "kept": kept,
            "parent_energy": parent_energy,
        }
        if kept:
            energy = self._energy(parent.degree - assessment.degree, degree_term, novelty)
            learned["energy"] = energy
            self._keep(candidate, behavior, assessment, energy, known=novel or options.known == "kept")
        if kept and novel:
            self._n_novel += 1
            if behavior is not None and self._miner.due:
                self._miner.fit()
        return learned

    def _novelty(self, candidate: Candidate, parent: Testcase, behavior: Behavior | None) -> tuple[float, float]:
        """Compute the distances of a mutant's behavior from the nearest in Y and from its parent's (equations 8, 9)."""
        if self._options.novelty == "random":
            novelty, distance = draws(self._seed, candidate.number, _NOVELTY_DRAWS).random(2).tolist()
            return novelty, distance
        if behavior is None:
            return 0.0, 0.0
        distances = self._miner.distances(self._miner.abstract(behavior))
        return float(distances[self._known].min()), float(distances[parent.behavior])

    def _energy(self, gain: float, degree_term: float, novelty: float) -> float:
        """Compute E_s' of a kept mutant from its gain in degree [m], its dE_V and its novelty."""
        if self._options.mutant_energy == "degree-and-novelty":
            return 1 + gain / 2 + novelty / 2
        return 1 + self._options.degree_weight * degree_term  # paper equation 17

    def _changed_energy(self, parent: Testcase, kind: str, degree_term: float, failed: bool) -> float:
        """Count the outcome of the parent's mutant s', and compute the parent's E_s after it (paper equation 14)."""
        options = self._options
        energy = self._corpus.energy(parent.number)
        if kind == self._logical.mutations.much and options.route_cost is not None:
            energy -= options.route_cost
        else:
            parent.n_failed += failed
            parent.n_passed += not failed
            energy += options.failure_weight * failure_change(failed, parent.n_failed, parent.n_passed)
            energy += options.degree_weight * degree_term + options.selection_weight * SELECTION_CHANGE
        return energy if options.least_energy is None else max(energy, options.least_energy)

    def _keep(
        self, candidate: Candidate, behavior: Behavior | None, assessment: Assessment, energy: float, *, known: bool
    ) -> None:
        """Add a candidate to the corpus. If `known`, its behavior joins Y: those near it are no longer novel."""
        index = self._miner.add(behavior) if behavior is not None else _NOT_MINED
        if known and behavior is not None:
            self._known = np.append(self._known, index)
        testcase = Testcase(candidate.number, candidate.scenario, assessment.degree, index)
        self._corpus.add(testcase, energy)

    def status(self) -> Mapping[str, float]:
        """Return the size of the corpus, its mean and greatest energy, and the number of novel mutants kept."""
        energies = self._corpus.energies
        return {
            "corpus": len(energies),
            "mean_energy": float(energies.mean()) if len(energies) else 0.0,
            "max_energy": float(energies.max()) if len(energies) else 0.0,
            "novel_kept": self._n_novel,
        }
