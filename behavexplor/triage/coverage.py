"""Coverage of the rule planner's weaknesses by a campaign: reached, triggered, detected."""

from collections.abc import Iterable, Sequence

import numpy as np

from behavexplor.data.decision_log import WEAKNESS_NAMES, weakness_names
from behavexplor.data.trace import Trace
from behavexplor.triage.findings import Finding, Sighting, WeaknessRecord


def weakness_records(traces: Iterable[tuple[int, Trace]], findings: Sequence[Finding]) -> dict[str, WeaknessRecord]:
    """Count the executions that reached or triggered each weakness, and the failures that it caused.

    Args:
        traces: traces of all executions of the rule planner with their numbers, in order.
        findings: findings of its failures, in order.

    Returns:
        The record of each weakness by name.
    """
    bits = ("reached", "triggered")
    seen: dict[str, dict[str, list[int]]] = {name: {bit: [] for bit in bits} for name in WEAKNESS_NAMES}
    for number, trace in traces:
        for bit in bits if len(trace.actions) else ():
            for name in weakness_names(int(np.bitwise_or.reduce(trace.decisions[bit].astype(np.int64)))):
                seen[name][bit].append(number)
    detected = {name: [finding.id for finding in findings if finding.cause == name] for name in WEAKNESS_NAMES}
    return {
        name: WeaknessRecord(
            Sighting.of(found["reached"]), Sighting.of(found["triggered"]), Sighting.of(detected[name])
        )
        for name, found in seen.items()
    }
