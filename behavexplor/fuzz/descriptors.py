"""What a run was like, in a few numbers: where quality-diversity methods keep their scenarios apart."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from behavexplor.behavior.features import state_matrix
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError

Floats = NDArray[np.float64]
Measure = Literal["mean-speed", "braking", "cornering", "standing", "duration"]

SCALES: Mapping[Measure, float] = MappingProxyType(  # what counts as 1, and all beyond it
    {
        "mean-speed": 12.0,  # of the ego [m/s]
        "braking": 8.0,  # its hardest [m/s2]
        "cornering": 4.0,  # its greatest acceleration across its heading [m/s2]
        "standing": 1.0,  # share of the time that it stood
        "duration": 120.0,  # [s]
    }
)
_SLOW = 0.3  # less counts as standing [m/s], as it does at the end of an episode


def describe(trace: Trace, measures: Sequence[Measure]) -> Floats:
    """Measures of the ego's behavior in a run.

    Args:
        trace: of the run.
        measures: which.

    Returns:
        Shape (measures,), each in [0, 1].
    """
    states = state_matrix(trace).astype(np.float64)
    speed, across = states[:, 0], np.abs(states[:, 5])
    values = {
        "mean-speed": speed.mean() if len(speed) else 0.0,
        "braking": -states[:, 1].min(initial=0.0),
        "cornering": across.max(initial=0.0),
        "standing": (speed < _SLOW).mean() if len(speed) else 1.0,
        "duration": trace.duration,
    }
    return np.asarray(np.clip([values[name] / SCALES[name] for name in measures], 0.0, 1.0))


def check_measures(measures: Sequence[Measure]) -> None:
    """Refuse measures that span no space.

    Raises:
        InputError: if there is none, or one is named twice.
    """
    if not measures or len(set(measures)) < len(measures):
        raise InputError(f"measures: name each of them once, at least one; got {', '.join(measures) or 'none'}")
