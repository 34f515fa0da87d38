"""Flags that several commands share, their checks, and the note that a driver is loading.

The help text of a flag is in the docstring of its command's function, or of the dataclass that it is a field of: a
group of flags (such as `Running` here), or the configuration, see `behavexplor.commands.config_flags`.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Annotated, Any, Final

import tyro

from behavexplor.campaign.config import read_yaml
from behavexplor.campaign.provenance import JUDGED, AcceptedConfig, Consent
from behavexplor.campaign.same_driver import accepted_run
from behavexplor.data.target import Activation
from behavexplor.errors import InputError
from behavexplor.execution.executor import MOST_WORKERS, available_cores

Switch = tyro.conf.FlagCreatePairsOff[bool]  # off without the flag
RunFolder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
NewFolder = Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
Trust = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="DIGEST")]
GivenActivation = Annotated[
    Activation | None, tyro.conf.DisallowNone, tyro.conf.arg(metavar="NAME", help_behavior_hint="")
]
WAITING: Final = "Loading the driver; first-time compilation can take a minute ..."


def flag(metavar: str, default: object) -> Any:
    """Return tyro's settings of a flag whose parameter is None if it is not given.

    Args:
        metavar: name of the flag's value in the help text.
        default: what holds without the flag, for the help text; None to show nothing.
    """
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})" if default is not None else "")


@dataclass(frozen=True)
class Running:
    """How a command runs again the driver that a folder names.

    Attributes:
        workers: Number of worker processes (no effect on the results). 0: this process, with no limits for the driver;
            a driver that is not shipped with behavexplor then needs --unconfined.
        trust: Allow the folder or policy file with this digest ("sha256:...") to execute code. May be repeated.
        unconfined: Allow a driver that is not shipped with behavexplor to write files and use the network.
        quiet: Print only the result.
    """

    workers: Annotated[int | None, flag("N", "the cores")] = None
    trust: Trust = ()
    unconfined: Switch = False
    quiet: Switch = False

    @property
    def n_workers(self) -> int:
        """Number of worker processes; see `chosen_workers`."""
        return chosen_workers(self.workers)

    def accepted_config(self, run: Path) -> AcceptedConfig:
        """Return the configuration of a run, after a check that the user allows the code of its driver and specs."""
        return accepted_run(run, Consent(self.trust, self.unconfined), JUDGED)


HowToRun = Annotated[Running, tyro.conf.arg(name="")]  # a parameter whose fields are flags


def read_env_config(file: Path) -> dict[str, Any]:
    """Read the YAML file that --env-config names; see `behavexplor.campaign.config.read_yaml`."""
    return read_yaml(file, "lanes_count: 3")


def check_unchanged(given: Mapping[str, Any], stored: Any, what: str) -> None:
    """Check that flags beside --resume do not change the configuration of what is resumed.

    Args:
        given: values of the flags, by the keys of the stored configuration.
        stored: the configuration.
        what: name of what is resumed, for the message.

    Raises:
        InputError: if a value differs.
    """
    for name, value in given.items():
        if value != getattr(stored, name):
            option = name.replace("_", "-")
            raise InputError(f"--{option} cannot be changed with --resume: the {what} has {getattr(stored, name)!r}")


def chosen_workers(workers: int | None) -> int:
    """Return the number of worker processes on this machine; by default one for each available core.

    Raises:
        InputError: if the number is out of range.
    """
    if workers is None:
        return min(available_cores(), MOST_WORKERS)
    if not 0 <= workers <= MOST_WORKERS:
        raise InputError(f"--workers {workers} must lie between 0 and {MOST_WORKERS}")
    return workers


@contextmanager
def patience(say: Callable[[str], object], note: str = WAITING, after: float = 5.0) -> Iterator[None]:
    """Say something if the code in this context takes longer than `after` seconds."""
    timer = Timer(after, say, [note])
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
