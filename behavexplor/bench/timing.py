"""How long the executions of a campaign took, and all else that it did, over any number of interruptions."""

import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

from behavexplor.campaign.progress import Progress
from behavexplor.data.validation import checked
from behavexplor.errors import InputError

TIMING: Final = "timing.json"  # in the run folder of an experiment's run
WRITE_SECONDS: Final = 5.0  # between two times that it is written [s]


@dataclass(frozen=True)
class Timing:
    """What was measured of a campaign, and whether its search has come to its end.

    Attributes:
        executions: how many were measured; after a power cut some are not.
        executing: time spent on them [s].
        analysing: time spent on all else: choosing, judging, learning, storing [s].
        ended: why the search ended before its budget, if it did.
    """

    executions: int = 0
    executing: float = 0.0
    analysing: float = 0.0
    ended: str | None = None


def read_timing(folder: Path) -> Timing:
    """What was measured in a run folder; nothing if there is no record of it.

    Raises:
        InputError: if the record is damaged.
    """
    try:
        values = json.loads((folder / TIMING).read_text())
    except FileNotFoundError:
        return Timing()
    except (OSError, ValueError) as error:
        raise InputError(f"{folder / TIMING} cannot be read: {error}") from None
    if not isinstance(values, dict):
        raise InputError(f"{folder / TIMING} is damaged: delete it to go on without what was measured")
    return checked(Timing, values, f"timing in {folder}")


class Stopwatch:
    """Adds up where a campaign's time goes, and keeps it in its folder.

    Stored executions that a resumed campaign only looks at again are not measured: they were when they ran.

    Args:
        folder: of the campaign.
        elapsed: running time of the campaign when it begins [s].
    """

    def __init__(self, folder: Path, elapsed: float) -> None:
        self._folder = folder
        self._earlier = read_timing(folder)
        self._base = elapsed
        self._written = time.monotonic()
        self.timing = self._earlier

    def observe(self, progress: Progress) -> None:
        """Take in how far the campaign has come."""
        fresh = progress.executions - progress.resumed
        if not fresh:
            self._base = progress.elapsed
            return
        earlier = self._earlier
        analysing = max(progress.elapsed - self._base - progress.executing, 0.0)
        self.timing = replace(
            earlier,
            executions=earlier.executions + fresh,
            executing=earlier.executing + progress.executing,
            analysing=earlier.analysing + analysing,
        )
        if time.monotonic() - self._written >= WRITE_SECONDS:
            self.write()

    def end(self, ended: str | None) -> None:
        """Keep why the search ended before its budget, if it did."""
        self.timing = replace(self.timing, ended=ended)

    def write(self) -> None:
        """Bring it to disk."""
        self._written = time.monotonic()
        partial = self._folder / f"{TIMING}.part"
        partial.write_text(json.dumps(asdict(self.timing)))
        partial.replace(self._folder / TIMING)
