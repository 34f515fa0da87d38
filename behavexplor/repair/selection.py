"""Selection of the failures of runs from which a suite is made: one of each class, at fault, and reproducible."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.record import ERROR, Record
from behavexplor.campaign.store import Store
from behavexplor.data.trace import Trace
from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError
from behavexplor.judge.classes import violation_class
from behavexplor.judge.fault import is_at_fault
from behavexplor.judge.robustness import load_specs
from behavexplor.judge.specs import judge
from behavexplor.repair.cases import Case
from behavexplor.triage.findings import Finding
from behavexplor.triage.minimized import Minimized, trace_path


def candidates(records: Iterable[Record], known: Mapping[int, Finding]) -> dict[str, list[int]]:
    """Return the numbers of the failures for which the driver was at fault, by class, in order.

    Args:
        records: the records of a run.
        known: findings of triage by the numbers of the executions. Their fault replaces that of the record.
    """
    found: dict[str, list[int]] = {}
    for record in records:
        fault = known[record.id].fault if record.id in known else record.fault
        is_drivers = record.at_fault and is_at_fault(fault) and record.violated != (ERROR,)
        if is_drivers and record.violation_class is not None:
            found.setdefault(record.violation_class, []).append(record.id)
    return found


def case_of(store: Store, config: CampaignConfig, minimal: Minimized) -> Case:
    """Return the case of a minimized failure."""
    specs = load_specs(config.specs)
    trace = Trace.from_bytes(read_file(trace_path(store.folder, minimal.id)))
    kind = violation_class(trace, judge(trace, specs).violated)
    return Case(
        words=kind.words if kind else minimal.class_id,
        class_id=minimal.class_id,
        run=store.folder.resolve().name,
        execution=minimal.id,
        fault=minimal.fault,
        cause=minimal.cause,
        holds=tuple(spec.name for spec in specs),
        scenario=minimal.scenario,
    )


def check_same_driving(first: tuple[Path, CampaignConfig], others: Iterable[tuple[Path, CampaignConfig]]) -> None:
    """Check that runs can be the source of one suite.

    Raises:
        InputError: if they were made in different environments, or judged by different specs.
    """
    for folder, config in others:
        for name in ("env", "env_config", "traffic", "stochastic", "specs"):
            own, other = getattr(first[1], name) or None, getattr(config, name) or None
            if own != other:
                raise InputError(
                    f"{folder} and {first[0]} cannot be in one suite: their {name} is {other!r} and {own!r}; "
                    "write one suite for each"
                )
