"""`behavexplor records`: the executions of a run as JSON lines."""

import json
import sys
from pathlib import Path
from typing import Annotated

import tyro

from behavexplor.store import Store


def records(run: Annotated[Path, tyro.conf.Positional]) -> int:
    """Print one JSON object per execution, in order; equal campaigns print equal lines.

    Args:
        run: the run folder.
    """
    store = Store.read(run)
    for execution in store.executions():
        sys.stdout.write(json.dumps(execution.record, separators=(",", ":")) + "\n")
    sys.stdout.flush()
    store.close()
    return 0
