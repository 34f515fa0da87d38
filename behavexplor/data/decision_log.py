"""Decision log of the rule planner in a trace: which weaknesses were reached and triggered, as bits.

The sixteen weaknesses are those that the paper found in Apollo 6.0 (section 4.1.2).
"""

from typing import Final

WEAKNESS_NAMES: Final = (
    *(f"R1-{i}" for i in range(1, 9)),
    *(f"R2-{i}" for i in range(1, 5)),
    *(f"R3-{i}" for i in range(1, 5)),
)
ENVIRONMENT: Final = "environment"  # cause of a failure that no weakness explains: the planner without any fails too
UNKNOWN: Final = "unknown"  # cause of a failure for which no single weakness is to blame


def bit_of(name: str) -> int:
    """Return the bit of a weakness in an entry of the decision log."""
    return 1 << WEAKNESS_NAMES.index(name)


def weakness_names(bits: int) -> tuple[str, ...]:
    """Return the weaknesses in an entry of the decision log, such as `trace.decisions["triggered"][i]`."""
    return tuple(name for i, name in enumerate(WEAKNESS_NAMES) if int(bits) >> i & 1)
