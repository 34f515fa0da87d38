"""Variation of kept scenarios (elites) in quality-diversity methods."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

import numpy as np

from behavexplor.behavior.features import state_matrix
from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import STANDING_SPEED
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.errors import InputError
from behavexplor.fuzz.search import INITIAL, Candidate
from behavexplor.fuzz.vector_search import Asker

VARIATION: Final = "variation"  # origin of candidates
ELITES: Final = "number"  # archive field with the candidate number of each elite
Measure = Literal["mean-speed", "braking", "cornering", "standing", "duration"]
SCALES: Mapping[Measure, float] = MappingProxyType(  # values that are scaled to 1; greater values are clipped to 1
    {
        "mean-speed": 12.0,  # mean speed of the ego [m/s]
        "braking": 8.0,  # hardest braking of the ego [m/s2]
        "cornering": 4.0,  # greatest acceleration of the ego across its heading [m/s2]
        "standing": 1.0,  # share of the time in which the ego stood still
        "duration": 120.0,  # duration of the execution [s]
    }
)


@validated
class VariationOptions:
    """Variation along the line through two elites (Vassiliades and Mouret, GECCO 2018, equation 1).

    Attributes:
        iso_sigma: standard deviation of the noise on every gene, as a share of its range.
        line_sigma: standard deviation of the step toward the second elite, as a share of the distance.
        npc_keep_probability: probability that an NPC stays as in the first elite. Noise on all NPCs at once would
            destroy most of what made the elite good.

    Raises:
        InputError: if an option is out of range; the message names it.
    """

    iso_sigma: Annotated[float, between(1e-3, 1)] = 0.05
    line_sigma: Annotated[float, between(0, 10)] = 0.2
    npc_keep_probability: Annotated[float, between(0, 0.95)] = 0.5


def ask_elites(asker: Asker, archive: Any, initial: int, options: VariationOptions) -> Candidate:
    """Return a uniform scenario at first, then variations of two uniformly drawn elites.

    Args:
        asker: vector search that makes the candidate.
        archive: archive of pyribs with the field `ELITES`.
        initial: number of uniform scenarios. While the archive is empty, all scenarios are uniform.
        options: options of the variation.
    """
    rng = asker.draws()
    if archive.empty or asker.asked < initial:
        return asker.candidate(asker.uniform(rng)[0], rng, INITIAL)
    return _varied(asker, archive, options, rng)


def _varied(asker: Asker, archive: Any, options: VariationOptions, rng: np.random.Generator) -> Candidate:
    from ribs.emitters.operators import IsoLineOperator  # noqa: PLC0415 - slow to import

    elites = archive.data(["solution", ELITES])
    first, second = rng.integers(len(elites[ELITES]), size=2)
    parents = elites["solution"][[first, second]]
    operator = IsoLineOperator(options.iso_sigma, options.line_sigma, seed=int(rng.integers(2**63)))
    blocks = operator.ask(parents[:, None])[0].reshape(asker.encoding.n_blocks, -1)
    stay = rng.random(len(blocks)) < options.npc_keep_probability
    blocks[stay] = parents[0].reshape(blocks.shape)[stay]
    return asker.candidate(np.clip(blocks.ravel(), 0.0, 1.0), rng, VARIATION, int(elites[ELITES][first]))


def describe(trace: Trace, measures: Sequence[Measure]) -> Floats:
    """Compute measures of the ego's behavior in an execution.

    Args:
        trace: trace of the execution.
        measures: measures to compute.

    Returns:
        Measures in [0, 1], shape (measures,).
    """
    states = state_matrix(trace).astype(np.float64)
    speed, across = states[:, 0], np.abs(states[:, 5])
    values = {
        "mean-speed": speed.mean() if len(speed) else 0.0,
        "braking": -states[:, 1].min(initial=0.0),
        "cornering": across.max(initial=0.0),
        "standing": (speed < STANDING_SPEED).mean() if len(speed) else 1.0,
        "duration": trace.duration,
    }
    return np.asarray(np.clip([values[name] / SCALES[name] for name in measures], 0.0, 1.0))


def check_measures(measures: Sequence[Measure]) -> None:
    """Check that there is at least one measure, and that no measure is named twice.

    Raises:
        InputError: if there is none, or one is named twice.
    """
    if not measures or len(set(measures)) < len(measures):
        raise InputError(f"measures: name at least one, and each only once; got {', '.join(measures) or 'none'}")
