"""`behavexplor report`: the findings of a run as one HTML page."""

from pathlib import Path
from typing import Annotated

import tyro

from behavexplor.bench.experiment import EXPERIMENT
from behavexplor.commands import OK
from behavexplor.commands.shared_flags import flag
from behavexplor.commands.wording import say
from behavexplor.errors import InputError
from behavexplor.report.reading import read_run
from behavexplor.report.run_page import PAGE, page, written


def report(
    runs: Annotated[
        tuple[Path, ...], tyro.conf.arg(metavar="RUN...", help_behavior_hint="(at least one)"), tyro.conf.Positional
    ],
    *,
    out: Annotated[Path | None, flag("FILE", "report.html in RUN; of several, in this folder")] = None,
    replays: Annotated[int, tyro.conf.arg(metavar="N")] = 100,
) -> int:
    """Write the findings of a run as one self-contained HTML file: violations with replays, curves, behaviors.

    Fault and causes of the failures are included if `triage` was called before.

    Args:
        runs: Run folders; several are compared.
        out: The HTML file to write.
        replays: Maximum number of replays of each run in the page; each takes about 2 kB.
    """
    if not runs:
        raise InputError("report needs at least one run folder: behavexplor report RUN")
    for run in runs:
        if (run / EXPERIMENT).is_file():
            raise InputError(f"{run} is the folder of an experiment: its page is {run / PAGE}, which `bench` writes")
    path = out or (runs[0] / PAGE if len(runs) == 1 else Path(PAGE))
    say(f"Report: {written(path, page([read_run(run) for run in runs], replays))}")
    return OK
