"""Checks of a driver against a suite."""

import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from behavexplor.campaign.identity import changes
from behavexplor.campaign.provenance import ADS, JUDGED, Consent, agreed
from behavexplor.campaign.same_driver import driver_digests
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError, sentence
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import ADSError, Executor
from behavexplor.execution.start import logical_of_target, start_executor
from behavexplor.judge.classes import violation_class
from behavexplor.judge.fault import own_violations
from behavexplor.judge.robustness import load_specs
from behavexplor.judge.specs import Spec, judge
from behavexplor.repair.cases import Case, Suite


@dataclass(frozen=True)
class CheckedCase:
    """What a driver did in the scenario of a case."""

    case: Case  # the case
    violated: tuple[str, ...]  # names of the specs that had to hold and did not
    words: str  # what happened, as a sentence

    @property
    def passed(self) -> bool:
        """True if everything held that had to hold, and the driver did not fail."""
        return not self.violated


class Checker:
    """Drives the cases of a suite by an executor of the driver, and judges them by the suite's specs."""

    def __init__(self, executor: Executor, logical: LogicalScenario, specs: Sequence[Spec]) -> None:
        self._executor = executor
        self._logical = logical
        self._specs = specs

    def __call__(self, case: Case) -> CheckedCase:
        """Drive one case.

        Raises:
            InputError: if its scenario does not belong to the environment.
            RuntimeError: if it could not be executed.
        """
        return self._checked(case, self._begun(case))

    def all_of(self, cases: Sequence[Case]) -> Iterator[CheckedCase]:
        """Drive many cases at a time, and yield the results in the order of the cases; see `__call__`."""
        begun = [self._begun(case) for case in cases]
        for case, future in zip(cases, begun, strict=True):
            yield self._checked(case, future)

    def _begun(self, case: Case) -> "Future[bytes]":
        scenario = self._logical.adopted(case.load_scenario())
        return self._executor.submit(EXECUTE, scenario.to_json().encode())

    def _checked(self, case: Case, future: "Future[bytes]") -> CheckedCase:
        try:
            trace = Trace.from_bytes(future.result())
        except ADSError as error:
            return CheckedCase(case, ("error",), sentence(str(error)))
        violated = own_violations(trace, judge(trace, self._specs).violated)
        kind = violation_class(trace, violated)
        words = kind.words if kind else "Violated " + ", ".join(violated) if violated else "Passed"
        return CheckedCase(case, tuple(name for name in violated if name in case.holds), words)


def _check_names(suite: Suite, known: Sequence[str]) -> None:
    """Check the specs that have to hold."""
    for case in suite.cases:
        if not case.holds or not set(case.holds) <= set(known):
            raise InputError(
                f"{case.name}: holds: expected one or more of {', '.join(sorted(known))}, got {list(case.holds)}"
            )


@contextmanager
def opened_driver(
    suite: Suite, ads: str | None, workers: int = 1, trust: Sequence[str] = (), **settings: Any
) -> Iterator[Checker]:
    """Load a driver, and return what drives the cases of a suite with it.

    Args:
        suite: the suite.
        ads: name of the driver; None for that of the suite.
        workers: greatest number of worker processes; 0 for this process.
        trust: digests of what may run code.
        settings: further fields of the `behavexplor.data.target.Target`.

    Raises:
        InputError: if the suite names code that the user has not agreed to, the driver cannot be loaded or does not fit
            the environment, or a case names an unknown spec.
    """
    consent = Consent(tuple(trust), names=() if ads is None else (ads,))
    found = agreed(suite.claim, consent, JUDGED if ads in (None, suite.driver) else JUDGED - {ADS})
    if ads is None and suite.digests:
        changed = changes(suite.digests, driver_digests(suite.driver, suite.claim.code))
        if changed:
            warnings.warn(f"The driver is not the one that failed in the suite: {changed}", stacklevel=3)
    target = suite.target(ads or suite.driver, trust=consent.trust, modules=found.modules, **settings)
    with start_executor(target, workers) as executor:
        specs = load_specs(suite.specs)
        _check_names(suite, [spec.name for spec in specs])
        yield Checker(executor, logical_of_target(executor, suite.env), specs)
