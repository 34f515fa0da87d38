"""`behavexplor demo`: train a small policy, fuzz it and show what was found, by the commands that anyone would use."""

import shlex
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import tyro

from behavexplor.campaign.config import stamped_folder
from behavexplor.commands import OK, main, program
from behavexplor.commands.display import Meter
from behavexplor.commands.shared_flags import flag
from behavexplor.commands.wording import say
from behavexplor.data.durable import make_folder, writing
from behavexplor.errors import InputError, missing_library
from behavexplor.report.run_page import PAGE


def demo(
    *,
    out: Annotated[Path | None, flag("FOLDER", "a new one in runs/")] = None,
    budget: Annotated[str, tyro.conf.arg(metavar="N|TIME")] = "45s",
    steps: Annotated[int, tyro.conf.arg(metavar="N")] = 20_000,
    browser: bool = True,
) -> int:
    """Train a small policy on highway-env's highway, search for its failures, and open the report, in two minutes.

    Args:
        out: Folder for the policy and the run, new or empty.
        budget: Budget of the search: number of executions, or running time.
        steps: Number of training steps.
        browser: Open the report in a browser.
    """
    try:
        from behavexplor.sb3.small_policy import train_small_policy  # noqa: PLC0415 - torch need not be installed
    except ModuleNotFoundError as error:
        raise missing_library("The demo", error.name, "rl") from None
    folder = out or stamped_folder("demo")
    with writing(f"The folder {folder}"):
        make_folder(folder)  # creates it
    if any(folder.iterdir()):
        raise InputError(f"{folder} is not empty: choose another --out")
    say(f"Training a small policy with PPO for {steps} steps ...", flush=True)
    with Meter(sys.stderr, steps, "steps", quiet=False) as meter:
        model = train_small_policy(folder, steps, meter.show)
    run = folder / "run"
    for words in (("fuzz", "--ads", model, "--budget", budget, "--out", run), ("report", run)):
        if (code := _run(*words)) != OK:
            return code
    if browser:
        webbrowser.open((run / PAGE).resolve().as_uri())
    return OK


def _run(*words: object) -> int:
    """Print a command as the user would type it, run it, and return its exit code."""
    arguments = [str(word) for word in words]
    say(f"\n$ {program()} {shlex.join(arguments)}", flush=True)
    return main(arguments)
