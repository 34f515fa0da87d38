"""Grid of the speed search: its stages, accelerations and bins."""

import math
from typing import Final

from behavexplor.jit import kernel_inner

STAGES: Final = (2, 2, 4, 4, 4, 4, 6, 6)  # number of intervals in each stage of constant acceleration
ACCELERATIONS: Final = (-8.0, -5.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 4.0)  # candidate accelerations [m/s2]
HARDEST: Final = (0, 0, 1, 1, 2, 2, 2, 2)  # index of the hardest braking in each stage
STRONGEST: Final = (8, 8, 8, 8, 7, 7, 7, 7)  # index of the strongest acceleration in each stage

FINENESS: Final = 2.5  # bins per root of distance or speed, fine near 0; a stage keeps one node a bin
N_STATION_BINS: Final = 42
N_SPEED_BINS: Final = 16
N_BINS: Final = N_STATION_BINS * N_SPEED_BINS


@kernel_inner
def station_bin(driven: float) -> int:
    """Return the row of bins for a distance since the start of the plan [m]."""
    return min(int(FINENESS * math.sqrt(driven)), N_STATION_BINS - 1)


@kernel_inner
def speed_bin(speed: float) -> int:
    """Return the column of bins for a speed [m/s]."""
    return min(math.ceil(FINENESS * math.sqrt(speed)), N_SPEED_BINS - 1)
