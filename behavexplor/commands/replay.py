"""`behavexplor replay`: draw one execution, and check that it is reproducible."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from behavexplor.campaign.config import CampaignConfig, stored_config
from behavexplor.campaign.repetition import repeat_execution
from behavexplor.campaign.store import Execution, Store
from behavexplor.commands import CHECK_FAILED, OK
from behavexplor.data.drawn_scenario import DrawnScenario
from behavexplor.data.road_shape import RoadShape
from behavexplor.data.trace import CRASHED, Trace
from behavexplor.errors import InputError, sentence
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import start_executor
from behavexplor.report.captions import outcome
from behavexplor.report.drawing import decisive_frame, draw, save_animation
from behavexplor.report.road_shapes import known_road
from behavexplor.triage.closed_loop import drive_again
from behavexplor.triage.findings import OtherDriver, Witness, read_witness, witness_path
from behavexplor.triage.witness import avoids, replay_witness


def replay(
    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
    number: Annotated[int, tyro.conf.arg(name="id", metavar="ID"), tyro.conf.Positional],
    *,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: replays/ in RUN)")
    ] = None,
    avoided: bool = False,
) -> int:
    """Draw one execution as an animation (GIF) and its decisive frame (PNG), and run it again.

    The exit code is 1 if the repeated execution differs from the recorded one.

    Args:
        run: The run folder.
        number: Number of the execution, as in `records`.
        out: Folder for the pictures.
        avoided: Draw how the ego could have avoided the collision instead, if `triage` has called it preventable.
    """
    store = Store.read(run)
    execution = store.execution(number)
    store.close()
    config = stored_config(run)
    if avoided:
        return _avoid(execution, config, run, out or run / "replays")
    if (failure := execution.record.error) is not None:
        print(sentence(f"Execution {number}: the ADS failed ({failure['kind']}): {failure['message']}"))
    else:
        _show(execution, _road(config, run), out or run / "replays")
    return _compare(execution, config)


def _road(config: CampaignConfig, run: Path) -> RoadShape:
    """Return the road of a run; without surfaces if it is not known."""
    return known_road(config.env, run) or RoadShape(())


def _show(execution: Execution, shape: RoadShape, folder: Path) -> None:
    """Draw an execution.

    Raises:
        InputError: if the execution does not belong to this environment, or the pictures cannot be written.
    """
    foreign = f"Execution {execution.id} does not belong to the environment of this run"
    if len(execution.load_trace().illegal_lines) != len(shape.line_kinds):
        raise InputError(f"{foreign}: its trace has different illegal lines")
    try:
        _draw(execution, shape, folder)
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{foreign}: in its record, {error} is wrong or missing") from None


def _draw(execution: Execution, shape: RoadShape, folder: Path) -> None:
    """Write the pictures and print a description."""
    trace, caption = execution.load_trace(), outcome(execution.record.violated, execution.record.end)
    frame = decisive_frame(trace, execution.record.violated)
    degrees = ", ".join(f"{name} {degree:.2f}" for name, degree in execution.record.degrees.items())
    animation, picture = _save(trace, shape, frame, caption, folder / f"{execution.id:06d}")
    print(f"Execution {execution.id} {caption} after {trace.duration:.2f} s")
    print(f"Violation degrees, which guide the search (lower is nearer to a violation): {degrees}")
    print(f"Animation: {animation}\nDecisive frame, at {trace.time[frame]:.2f} s: {picture}")


def _save(trace: Trace, shape: RoadShape, frame: int, caption: str, path: Path) -> tuple[Path, Path]:
    """Write an animation of a trace and a picture of one frame, and return their paths.

    Raises:
        InputError: if they cannot be written.
    """
    animation, picture = path.with_suffix(".gif"), path.with_suffix(".png")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"The folder {path.parent} cannot be created: {error.strerror}") from None
    try:
        draw(trace, shape, frame, caption).save(picture)
        save_animation(animation, trace, shape, caption)
    except OSError as error:
        raise InputError(f"The pictures in {path.parent} cannot be written: {error.strerror}") from None
    return animation, picture


def _avoid(execution: Execution, config: CampaignConfig, run: Path, folder: Path) -> int:
    """Drive and draw the avoidance of a collision that triage has stored.

    Raises:
        InputError: if there is none.
    """
    file = witness_path(run, execution.id)
    if not file.is_file():
        raise InputError(
            f"No avoidance is stored for execution {execution.id}: `behavexplor triage {run}` stores one for each "
            "collision that it calls preventable"
        )
    witness, recorded = read_witness(file), execution.load_trace()
    trace, is_avoided = _driven(execution, config, witness, recorded)
    if not is_avoided:
        print(f"The maneuver in {file} does NOT avoid the collision.", file=sys.stderr)
        return CHECK_FAILED
    frame = min(len(recorded.time), len(trace.time)) - 1
    begin = witness.begin if isinstance(witness, Witness) else 0.0
    caption = f"{witness.name} from {begin:.2f} s on"
    path = folder / f"{execution.id:06d}-avoided"
    animation, picture = _save(trace, _road(config, run), frame, caption, path)
    print(f"Execution {execution.id} without its collision at {recorded.duration:.2f} s: {caption}")
    print(f"Animation: {animation}\nAt the time of the collision: {picture}")
    return OK


def _driven(
    execution: Execution, config: CampaignConfig, witness: Witness | OtherDriver, recorded: Trace
) -> tuple[Trace, bool]:
    """Drive a witness, and return its trace and whether it avoids the collision."""
    scenario = execution.scenario
    if isinstance(scenario, DrawnScenario) and isinstance(witness, OtherDriver):
        trace = drive_again(scenario, witness)
        return trace, not trace.signals[CRASHED].any()
    if isinstance(scenario, DrawnScenario) or isinstance(witness, OtherDriver):
        raise InputError(f"The avoidance stored for execution {execution.id} belongs to an environment of another kind")
    simulation = Simulation(config.env, "constant")  # any ADS will do, because the witness drives
    try:
        trace = replay_witness(simulation, scenario, witness)
    finally:
        simulation.close()
    return trace, avoids(trace, recorded, witness.begin)


def _compare(execution: Execution, config: CampaignConfig) -> int:
    """Run an execution again, in a separate process, and return the exit code of the comparison."""
    with start_executor(config.target, 1) as executor:
        again = repeat_execution(executor, execution)
    print(again.words, file=sys.stdout if again.reproduced else sys.stderr)
    return OK if again.reproduced else CHECK_FAILED
