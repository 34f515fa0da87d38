"""Timing of a campaign: time spent on executions and on everything else, across interruptions."""

import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

from behavexplor.campaign.progress import Progress
from behavexplor.data.durable import write_durably
from behavexplor.data.untrusted import read_file
from behavexplor.data.validation import checked
from behavexplor.errors import InputError

TIMING: Final = "timing.json"  # file in the run folder of an experiment's run
WRITE_SECONDS: Final = 5.0  # interval at which the file is written [s]


@dataclass(frozen=True)
class Timing:
    """Time measurements of a campaign.

    Attributes:
        executions: number of measured executions; after a power cut some may be missing.
        executing: time spent on them [s].
        analysing: time spent on everything else: choosing, judging, learning and storing [s].
        ended: reason why the search ended before its budget was used up; None if it did not.
    """

    executions: int = 0
    executing: float = 0.0
    analysing: float = 0.0
    ended: str | None = None


def read_timing(folder: Path) -> Timing:
    """Return the timing in a run folder; zeros if the folder has none.

    Raises:
        InputError: if the file is damaged.
    """
    try:
        values = json.loads(read_file(folder / TIMING))
    except FileNotFoundError:
        return Timing()
    except (OSError, ValueError) as error:
        raise InputError(f"{folder / TIMING} cannot be read: {error}") from None
    if not isinstance(values, dict):
        raise InputError(f"{folder / TIMING} is damaged: delete it to continue without its measurements")
    return checked(Timing, values, f"timing in {folder}")


class Stopwatch:
    """Measures the time of a campaign, and stores it in the run folder.

    Stored executions that a resumed campaign reads again are not measured, because they were measured when they ran.

    Args:
        folder: run folder.
        elapsed: running time of the campaign at the beginning [s].

    Attributes:
        timing: the timing so far.
    """

    def __init__(self, folder: Path, elapsed: float) -> None:
        self._folder = folder
        self._earlier = read_timing(folder)
        self._base = elapsed
        self._written = time.monotonic()
        self.timing = self._earlier

    def observe(self, progress: Progress) -> None:
        """Update the timing from the progress of the campaign."""
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
        """Record why the search ended before its budget was used up; None if it did not."""
        self.timing = replace(self.timing, ended=ended)

    def write(self) -> None:
        """Write the timing to disk."""
        self._written = time.monotonic()
        write_durably(self._folder / TIMING, json.dumps(asdict(self.timing)))
