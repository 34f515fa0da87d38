"""Behavior descriptors: a few measures of an execution, by which quality-diversity methods distinguish scenarios."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal

import numpy as np

from behavexplor.behavior.features import state_matrix
from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import STANDING_SPEED
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError

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
