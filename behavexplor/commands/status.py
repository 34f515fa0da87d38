"""`behavexplor status`: the figures of a run, also while it is being written."""

import time

from behavexplor.campaign.database_file import is_being_written
from behavexplor.campaign.run_summary import RunSummary, summarize
from behavexplor.campaign.store import last_written
from behavexplor.commands import OK
from behavexplor.commands.outputs import JsonFile, check_outputs, write_json
from behavexplor.commands.shared_flags import RunFolder
from behavexplor.commands.wording import clock, hanging, say, wrapped


def status(run: RunFolder, *, json_file: JsonFile = None) -> int:
    """Print how far a run is and what it has found, also while a campaign writes it.

    Args:
        run: The run folder.
        json_file: Write the figures to this JSON file; - is standard output.
    """
    output = check_outputs(json_file)
    found, is_running = summarize(run), is_being_written(run)
    ago = max(time.time() - last_written(run), 0.0)
    write_json(json_file, {"run": str(run), "running": is_running, "written_ago": ago, **found.to_dict()})
    classes = [hanging(f"{one.count:7}  ", f"{one.words} ({one.id}, first {one.first})") for one in found.classes]
    unsure = [wrapped(line) for line in found.not_confirmed]
    say("\n".join([_head(found, is_running=is_running, ago=ago), *classes, *unsure]), file=output)
    return OK


def _head(found: RunSummary, *, is_running: bool, ago: float) -> str:
    state = "running" if is_running else "complete" if found.complete else "stopped"
    lines = (
        f"{found.ads} in {found.env}, {found.method}, seed {found.seed}: {state}, last written {clock(ago)} ago",
        f"{found.executions} executions of a budget of {found.budget}, in {clock(found.elapsed)} "
        f"({found.rate:.1f} per second)",
        found.words,
    )
    return "\n".join(wrapped(line) for line in lines)
