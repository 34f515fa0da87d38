"""`behavexplor replay`: look at one execution, and check that it happens again."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from behavexplor.commands import CHECK_FAILED, EXECUTION_FAILED, OK, program
from behavexplor.config import stored_config
from behavexplor.drawing import decisive_frame, draw, save_animation
from behavexplor.errors import InputError
from behavexplor.simulation import Simulation
from behavexplor.store import Execution, Store


def replay(
    run: Annotated[Path, tyro.conf.Positional],
    number: Annotated[int, tyro.conf.arg(name="id", metavar="ID"), tyro.conf.Positional],
    *,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: replays/ in RUN)")
    ] = None,
) -> int:
    """Draw one execution as an animation (GIF) and its decisive moment (PNG), and run it again.

    The exit code is 1 if running it again gives another trace than the recorded one.

    Args:
        run: The run folder.
        number: The execution, as `records` numbers them.
        out: Where the pictures go.
    """
    store = Store.read(run)
    execution = store.execution(number)
    store.close()
    config = stored_config(run)
    simulation = Simulation(config.env, config.ads, config.trust)
    trace = execution.load_trace()
    try:
        again = simulation.run(execution.scenario)
    except Exception as error:  # of the ADS
        print(f"{program()}: The ADS failed on running it again, {type(error).__name__}: {error}", file=sys.stderr)
        return EXECUTION_FAILED
    folder = out or run / "replays"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"The folder {folder} cannot be made: {error.strerror}") from None
    animation, picture = folder / f"{number:06d}.gif", folder / f"{number:06d}.png"
    roadmap = simulation.logical.roadmap
    caption = _verdict(execution)
    frame = decisive_frame(trace, execution.record["violated"])
    draw(trace, roadmap, frame, caption).save(picture)
    save_animation(animation, trace, roadmap, caption)
    simulation.close()
    degrees = ", ".join(f"{name} {degree:.2f} m" for name, degree in execution.record["degrees"].items())
    print(f"Execution {number} {caption} after {trace.duration:.2f} s; violation degrees: {degrees}")
    print(f"Animation: {animation}\nDecisive moment, at {trace.time[frame]:.2f} s: {picture}")
    if again.to_bytes() != execution.trace:
        print("Running it again gave ANOTHER trace than the recorded one.", file=sys.stderr)
        return CHECK_FAILED
    print("Running it again gave the same trace.")
    return OK


def _verdict(execution: Execution) -> str:
    """What an execution did, after its number."""
    violated = " and ".join(execution.record["violated"]) or "nothing"
    return f"violates {violated}, ended by {execution.record['end']}"
