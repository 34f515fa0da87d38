"""The paper's Random: mutations of random testcases without feedback (section 4, baselines and ablation)."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from behavexplor.data.scenario import MAX_KEEP_PROBABILITY, MIN_SIGMA, LogicalScenario, Noise, Scenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.fuzz.search import INITIAL, MAX_FAILED_INITIAL, Candidate, draws, nothing_to_mutate
from behavexplor.judge.specs import Verdict

_KEEPING_DRAWS = 1  # purpose of the draws, to tell them apart from those that made the candidate


@validated
class RandomMutationOptions:
    """Options of `RandomMutation`. The mutations are those of the paper."""

    initial_corpus: Annotated[int, between(1)] = 4  # number of scenarios executed before the first mutation
    # probability that a mutant that passed becomes a testcase. The paper does not state it. With 0, only initial
    # scenarios are ever mutated. With 1, every mutant that passed becomes a testcase.
    keep_probability: Annotated[float, between(0, 1)] = 0.5
    # epsilon, the probability that an NPC stays unchanged
    npc_keep_probability: Annotated[float, between(0, MAX_KEEP_PROBABILITY)] = 0.5
    sigma_position: Annotated[float, between(MIN_SIGMA)] = 12.0  # standard deviation of waypoint mutation [m]
    sigma_speed: Annotated[float, between(MIN_SIGMA)] = 6.0  # standard deviation of waypoint mutation [m/s]
    # in highway-env environments, standard deviation of the small mutation of a draw, as a share of the draw's range
    sigma_draw: Annotated[float, between(MIN_SIGMA, 1)] = 0.1


class RandomMutation:
    """The paper's Random: random mutations of random testcases, without learning.

    This is BehAVExplor with a random choice in place of each decision: which testcase is mutated, by which mutation,
    and whether the mutant is kept. Failures are never kept.
    """

    Options: ClassVar[type] = RandomMutationOptions

    def __init__(self, logical: LogicalScenario, seed: int, options: RandomMutationOptions) -> None:
        self._logical = logical
        self._seed = seed
        self._options = options
        self._corpus: list[tuple[int, Scenario]] = []  # candidate numbers and scenarios
        self._asked = 0
        self._told = 0

    def ask(self) -> Candidate:
        """Return an initial scenario, or the mutant of a random testcase.

        Raises:
            SearchExhausted: if none of `MAX_FAILED_INITIAL` initial scenarios passed.
        """
        if not self._corpus and self._told >= MAX_FAILED_INITIAL:
            raise nothing_to_mutate(self._told)
        number = self._asked
        rng = draws(self._seed, number)
        self._asked += 1
        if self._told < self._options.initial_corpus or not self._corpus:
            return Candidate(number, self._logical.sample(rng), INITIAL, None)
        parent, scenario = self._corpus[rng.integers(len(self._corpus))]
        options, (little, much) = self._options, self._logical.mutations
        if rng.random() < 0.5:
            mutant = self._logical.mutate_much(scenario, rng, options.npc_keep_probability)
            return Candidate(number, mutant, much, parent)
        noise = Noise(options.npc_keep_probability, options.sigma_position, options.sigma_speed, options.sigma_draw)
        return Candidate(number, self._logical.mutate_little(scenario, rng, noise), little, parent)

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:  # noqa: ARG002
        """Keep a scenario that passed: an initial scenario always, a mutant at random. Return whether it was `kept`."""
        self._told += 1
        lucky = draws(self._seed, candidate.number, _KEEPING_DRAWS).random() < self._options.keep_probability
        kept = not verdict.failed and (candidate.parent is None or lucky)
        if kept:
            self._corpus.append((candidate.number, candidate.scenario))
        return {"kept": bool(kept)}

    def status(self) -> Mapping[str, float]:
        """Return the size of the corpus."""
        return {"corpus": len(self._corpus)}
