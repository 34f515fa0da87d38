"""`behavexplor suite`: a regression suite from the failures of runs."""

import shlex
import sys
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Annotated

import tyro

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.store import Store
from behavexplor.commands import OK, execution_failed, program
from behavexplor.commands.display import Meter
from behavexplor.commands.shared_flags import HowToRun, NewFolder, Running
from behavexplor.commands.wording import counted, say
from behavexplor.errors import InputError
from behavexplor.repair.cases import TEST, Case, Suite, candidates, case_of, check_free, check_same_driving
from behavexplor.triage.findings import known_findings
from behavexplor.triage.minimization import RunMinimization

TRIES = 3  # failures of one class that are tried, in case the first ones cannot be reproduced


def suite(
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(name="run", metavar="RUN [RUN ...]")],
    *,
    out: NewFolder,
    running: HowToRun,
) -> int:
    """Write a regression suite: one minimized scenario of each class of failures, and a test file for pytest.

    Only failures at fault count, as far as the trace can tell or as triage has found. Errors, in which the driver
    failed instead of driving, are left out.

    Args:
        runs: Run folders of one environment.
        out: Folder of the suite, new or empty.
        running: Flags; see `behavexplor.commands.shared_flags.Running`.
    """
    if not runs:
        raise InputError("Give at least one run folder, such as runs/my-run")
    check_free(out)  # before failures are minimized, which takes minutes
    configs = [(run, running.accepted_config(run)) for run in runs]
    check_same_driving(configs[0], configs[1:])
    cases: dict[str, Case] = {}
    try:
        for run, config in configs:
            for case in _cases(run, config, cases, running):
                cases.setdefault(case.class_id, case)
    except RuntimeError as error:
        return execution_failed(f"A failure could not be minimized: {error}")
    if not cases:
        raise InputError("Apart from errors, no failure is reproducible and at fault, so there is nothing to check")
    first = configs[0][1]
    Suite(
        env=first.env,
        driver=first.ads,
        specs=first.specs,
        env_config=first.env_config or {},
        traffic=first.traffic,
        stochastic=first.stochastic,
        activation=first.activation,
        cases=tuple(cases.values()),
    ).write(out)
    folder = shlex.quote(str(out))
    say(f"{counted(len(cases), 'scenario')}, one for each class of failures, in {folder}")
    say(f"Check a driver with:\n{program()} check {folder} --ads NAME")
    say(f"The same as tests:\nADS=NAME pytest {folder}/{TEST}")
    return OK


def _cases(run: Path, config: CampaignConfig, taken: Mapping[str, Case], running: Running) -> list[Case]:
    """Return a case for each class of a run that is not yet taken. Failures are minimized if they have not been."""
    made: list[Case] = []
    with closing(Store.read(run)) as store:
        found = candidates(store.records(), known_findings(run))
        left = {kind: ids for kind, ids in found.items() if kind not in taken}
        for attempt in range(TRIES):
            chosen = [ids[attempt] for ids in left.values() if len(ids) > attempt]
            if not chosen:
                break
            work = RunMinimization(run, config, running.n_workers, chosen)
            with Meter(sys.stderr, len(work.waiting), "failures", quiet=running.quiet) as meter:
                good = [minimal for minimal in work.minimize(meter.show) if minimal.reproduced]
            made += [case_of(store, config, minimal) for minimal in good]
            left = {kind: ids for kind, ids in left.items() if kind not in {minimal.class_id for minimal in good}}
    return made
