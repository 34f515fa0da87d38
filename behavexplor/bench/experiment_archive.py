"""The archive of an experiment: what its tables need of each finished campaign, in one small file.

With the archive, tables are made without the run folders, which are thousands of times as large, and an experiment
continues on another machine.
"""

import gzip
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from behavexplor.bench.experiment import PlannedRun
from behavexplor.bench.runs import check_same_campaign
from behavexplor.bench.summaries import Summary
from behavexplor.campaign.config import campaign_config
from behavexplor.campaign.folder_format import DATABASE
from behavexplor.data.durable import write_durably
from behavexplor.data.untrusted import decompressed, read_file
from behavexplor.data.validation import checked
from behavexplor.errors import InputError

ARCHIVE: Final = "campaigns.jsonl.gz"  # file in an experiment's folder, a line for each campaign

Archive = Mapping[PlannedRun, Summary]


def read_archive(runs: Sequence[PlannedRun], root: Path) -> Archive:
    """Return the summaries of those campaigns that are in the archive of an experiment and have no run folder.

    A campaign with a smaller budget than the experiment's is left out, so that it runs again.

    Raises:
        InputError: if the archive is damaged, or holds a campaign with a different configuration.
    """
    lines = _read_lines(root / ARCHIVE)
    found = {}
    for run in runs:
        line = lines.get(_key(run))
        if line is None or (root / run.folder / DATABASE).is_file():
            continue
        what = f"{_key(run)} in {root / ARCHIVE}"
        stored = campaign_config(line["config"])
        check_same_campaign(stored, run, what)
        if not stored.budget.isdecimal() or int(stored.budget) > int(run.config.budget):
            raise InputError(
                f"{what} has a budget of {stored.budget} executions, and the experiment one of {run.config.budget}: "
                "choose another --out"
            )
        if stored.budget == run.config.budget:
            found[run] = checked(Summary, line["summary"], what)
    return found


def write_archive(summaries: Archive, root: Path) -> None:
    """Add finished campaigns to the archive in an experiment's folder `root`, and keep those of other experiments.

    Raises:
        InputError: if the archive is damaged.
        OSError: if it cannot be written.
    """
    path = root / ARCHIVE
    lines = _read_lines(path)
    for run, summary in summaries.items():
        lines[_key(run)] = {"config": asdict(run.config), "summary": asdict(summary)}
    text = "".join(f"{json.dumps({'run': name, **line})}\n" for name, line in sorted(lines.items()))
    write_durably(path, gzip.compress(text.encode(), mtime=0))


def _key(run: PlannedRun) -> str:
    return run.folder.as_posix()


def _read_lines(path: Path) -> dict[str, dict[str, Any]]:
    """Return the lines of an archive by run; empty if there is no archive."""
    if not path.is_file():
        return {}
    try:
        lines = [json.loads(line) for line in decompressed(read_file(path)).decode().splitlines()]
        return {line["run"]: {name: dict(line[name]) for name in ("config", "summary")} for line in lines}
    except (OSError, ValueError, KeyError, TypeError, zlib.error) as error:
        raise InputError(f"{path} is damaged ({error}): restore it, or delete it to run its campaigns again") from None
