"""`behavexplor records`: the executions of a run as JSON lines."""

import json
import sys
from contextlib import closing
from dataclasses import asdict

from behavexplor.campaign.confirmation import read_confirmations
from behavexplor.campaign.folder_format import Losses
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, OK, program
from behavexplor.commands.shared_flags import RunFolder
from behavexplor.commands.wording import say


def records(run: RunFolder) -> int:
    """Print the record of each execution as one line of JSON, in order. Equal campaigns have equal records.

    A failure also says whether the driving system was at fault, as far as its trace can tell. If highway-env
    itself has repeated it, "confirmation" says what came out.

    From a damaged run, all readable records are printed, losses are reported on stderr, and the exit code is 2.

    Args:
        run: The run folder.
    """
    losses = Losses()
    confirmations = read_confirmations(run)
    with closing(Store.read(run)) as store:
        for record in store.records(losses):
            values = record.to_dict()
            if record.failed:
                values["at_fault"] = record.at_fault
            if record.id in confirmations:
                values["confirmation"] = asdict(confirmations[record.id])
            sys.stdout.write(json.dumps(values, separators=(",", ":")) + "\n")
    sys.stdout.flush()
    lost = losses.sentences(run)
    for sentence in lost:
        say(f"{program()}: {sentence}", file=sys.stderr)
    return BAD_INPUT if lost else OK
