"""`behavexplor replay`: draw one execution, and check that it is reproducible."""

import shlex
import sys
import textwrap
from collections.abc import Iterable
from contextlib import closing, suppress
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any

import tyro

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.confirmation import can_be_confirmed, keep, read_confirmations
from behavexplor.campaign.judgment import confirmation, repeat_execution
from behavexplor.campaign.provenance import DRIVING, Consent
from behavexplor.campaign.record import Record
from behavexplor.campaign.run_summary import snippet
from behavexplor.campaign.same_driver import accepted_run
from behavexplor.campaign.store import Execution, Store
from behavexplor.commands import CHECK_FAILED, OK, execution_failed, program
from behavexplor.commands.shared_flags import RunFolder, Switch, Trust, flag
from behavexplor.commands.wording import hanging, say, wrapped
from behavexplor.data.durable import make_folder, new_file, writing
from behavexplor.data.road_shape import RoadShape
from behavexplor.data.trace import ARRIVED, Trace
from behavexplor.errors import InputError, sentence
from behavexplor.execution.executor import ADSError
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import start_executor
from behavexplor.judge.specs import NOTHING_NEAR, Collision, Destination, judge
from behavexplor.report.drawing import Footage, decisive_frame, draw, footage_of, save_animation
from behavexplor.report.road_shapes import known_road
from behavexplor.triage.closed_loop import drive_again
from behavexplor.triage.findings import OtherDriver, Witness, known_findings, read_witness, witness_path
from behavexplor.triage.witness import avoids, replay_witness

COLLISION = Collision().name


def replay(
    run: RunFolder,
    number: Annotated[int, tyro.conf.arg(name="id", metavar="ID"), tyro.conf.Positional],
    *,
    out: Annotated[Path | None, flag("FOLDER", "replays/ in RUN")] = None,
    trust: Trust = (),
    avoided: Switch = False,
    unconfined: Switch = False,
) -> int:
    """Draw one execution as an animation (GIF) and its decisive frame (PNG), and run it again.

    The exit code is 1 if the repeated execution differs from the recorded one. A failure in one of highway-env's own
    environments is confirmed there, unless the run says --no-confirm.

    Args:
        run: The run folder.
        number: Number of the execution, as in `records`.
        out: Folder for the pictures.
        trust: Allow the folder or policy file with this digest ("sha256:...") to execute code. May be repeated.
        avoided: Draw how the ego could have avoided the collision instead, if `triage` has called it preventable.
        unconfined: Allow a driver that is not shipped with behavexplor to write files and use the network.
    """
    with closing(Store.read(run)) as store:
        execution = store.execution(number)
    config = accepted_run(run, Consent(trust, unconfined), DRIVING)
    if avoided:
        return _avoid(execution, config, run, out)
    if (failure := execution.record.error) is not None:
        say(sentence(f"Execution {number}: {ADSError(failure['kind'], failure['message'])}"))
    else:
        _show(execution, known_road(config.env, run), run, out)
        say(wrapped("The same episode in a loop of your own; any policy can take the place of env.driver:"))
        say(textwrap.indent(snippet(run, number), "    "))
    return _compare(execution, config, run)


def _show(execution: Execution, shape: RoadShape, run: Path, out: Path | None) -> None:
    """Draw an execution, and check that it belongs to the environment of the run."""
    foreign = f"Execution {execution.id} does not belong to the environment of this run"
    if shape.surfaces and len(execution.load_trace().illegal_lines) != len(shape.line_kinds):  # if the road is known
        raise InputError(f"{foreign}: its trace has different illegal lines")
    try:
        _draw(execution, shape, run, out)
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{foreign}: in its record, {error} is wrong or missing") from None


def _draw(execution: Execution, shape: RoadShape, run: Path, out: Path | None) -> None:
    """Write the pictures and print a description."""
    footage = footage_of(execution, shape)
    trace = footage.trace
    frame = decisive_frame(trace, execution.record.violated)
    degrees = _degrees_text(execution.record, trace)
    animation, picture = _save(footage, frame, run, out, f"{execution.id:06d}")
    say(wrapped(f"Execution {execution.id} {footage.caption} after {trace.duration:.2f} s"))
    if footage.decisions:
        say(wrapped(f"The driver's decisions: {_repetitions(name for _, name in footage.decisions)}"))
    say(wrapped("Violation degrees, which guide the search (lower is nearer to a violation):"))
    say(hanging("  ", degrees))
    say(f"Animation: {animation}\nDecisive frame, at {trace.time[frame]:.2f} s: {picture}")


def _degrees_text(record: Record, trace: Trace) -> str:
    """Return a record's degrees as text, without those of requirements for which nothing was near."""
    near = {name: degree for name, degree in record.degrees.items() if degree < NOTHING_NEAR}
    if trace.signals and ARRIVED not in trace.signals:  # there is no destination
        near.pop(Destination().name, None)
    marked = {name: " (violated)" if name in record.violated else "" for name in near}
    return ", ".join(f"{name} {degree:.2f}{marked[name]}" for name, degree in near.items())


def _repetitions(names: Iterable[str]) -> str:
    """Return names as text, each with the number of times that it follows itself."""
    repeated = [(name, len(list(alike))) for name, alike in groupby(names)]
    return ", ".join(name if count == 1 else f"{count} x {name}" for name, count in repeated)


def _save(footage: Footage, frame: int, run: Path, out: Path | None, name: str) -> tuple[Path, Path]:
    """Write an animation and a picture of one frame to `out`, or to the run's folder replays, and return their paths.

    Raises:
        InputError: if they cannot be written.
    """
    with writing(f"The folder {out or run / 'replays'}"):
        # of a run folder, `make_folder` refuses a link that leads out of it
        folder = make_folder(run, "replays") if out is None else make_folder(out)
    animation, picture = folder / f"{name}.gif", folder / f"{name}.png"
    with writing(f"The pictures in {folder}"):
        with new_file(picture) as file:
            draw(footage, frame).save(file, "PNG")
        with new_file(animation) as file:
            save_animation(file, footage)
    return animation, picture


def _avoid(execution: Execution, config: CampaignConfig, run: Path, out: Path | None) -> int:
    """Drive and draw the avoidance of a collision that triage has stored.

    Raises:
        InputError: if none is stored, or it cannot be driven in this environment.
    """
    file = witness_path(run, execution.id)
    if not file.is_file():
        raise InputError(_why_not_avoided(execution, run))
    witness = read_witness(file)
    recorded = execution.load_trace()
    trace, is_avoided = _driven(execution, config, witness, recorded)
    if not is_avoided:
        say(f"The driving in {file} does NOT avoid the collision, or fails in another way.", file=sys.stderr)
        return CHECK_FAILED
    frame = min(len(recorded.time), len(trace.time)) - 1
    caption = f"{witness.name} from {witness.begin:.2f} s on" if isinstance(witness, Witness) else witness.name
    footage = replace(footage_of(execution, known_road(config.env, run)), trace=trace, caption=caption, violated=())
    animation, picture = _save(footage, frame, run, out, f"{execution.id:06d}-avoided")
    say(f"Execution {execution.id} without its collision at {recorded.duration:.2f} s: {caption}")
    say(f"Animation: {animation}\nAt the time of the collision: {picture}")
    return OK


def _why_not_avoided(execution: Execution, run: Path) -> str:
    """Return why no avoidance of a collision is stored, as a sentence."""
    number = execution.id
    findings = known_findings(run)
    if COLLISION not in execution.record.violated:
        return f"Execution {number} has no collision that could be avoided"
    if number in findings:
        return f"No avoidance of the collision in execution {number} is known: its fault is {findings[number].fault}"
    command = f"{program()} triage {shlex.quote(str(run))}"
    return f"The collision in execution {number} has not been examined yet: {command} looks for ways to avoid it"


def _driven(
    execution: Execution, config: CampaignConfig, witness: Witness | OtherDriver, recorded: Trace
) -> tuple[Trace, bool]:
    """Drive a witness, and return its trace and whether it avoids the collision and fails in no other way."""
    scenario: Any = execution.scenario  # of the witness's kind, as is checked
    is_for_highway = isinstance(witness, OtherDriver)
    if is_for_highway != scenario.has_original:
        raise InputError(f"The avoidance stored for execution {execution.id} belongs to an environment of another kind")
    if isinstance(witness, OtherDriver):
        trace = drive_again(scenario, witness)
        return trace, not judge(trace).failed
    simulation = Simulation(config.env, "constant")  # any ADS will do, because the witness drives
    try:
        trace = replay_witness(simulation, scenario, witness)
    finally:
        simulation.close()
    return trace, avoids(trace, recorded, witness.begin)


def _compare(execution: Execution, config: CampaignConfig, run: Path) -> int:
    """Run an execution again, in a separate process, and return the exit code of the comparison.

    A failure in one of highway-env's environments is also confirmed there, if that has not been tried.
    """
    tried = read_confirmations(run).get(execution.id)
    try:
        with start_executor(config.target, 1) as executor:
            repetition = repeat_execution(executor, execution)
            if tried is None and config.confirm and can_be_confirmed(execution.record):
                tried = confirmation(executor, execution)
                with suppress(OSError):  # it may be someone else's folder, and not writable
                    keep(run, execution.id, tried)
    except RuntimeError as error:
        return execution_failed(f"The execution could not be repeated: {error}")
    if tried is not None:
        say(wrapped(tried.said_of(execution.id)), file=sys.stdout if tried.state == "confirmed" else sys.stderr)
    say(wrapped(repetition.words), file=sys.stdout if repetition.reproduced else sys.stderr)
    return OK if repetition.reproduced else CHECK_FAILED
