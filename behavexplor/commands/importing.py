"""`behavexplor import`: make a scenario from a scene, and execute it."""

import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import tyro

from behavexplor.campaign.judgment import ads_failure, judgment
from behavexplor.commands import OK, execution_failed
from behavexplor.commands.outputs import write_json
from behavexplor.commands.roads import check_libraries, road_of
from behavexplor.commands.shared_flags import GivenActivation, Switch
from behavexplor.commands.wording import say, wrapped
from behavexplor.data.named_code import env_code
from behavexplor.data.scenario import LogicalScenario, Scenario
from behavexplor.data.target import Target
from behavexplor.errors import InputError, sentence
from behavexplor.exchange.restoring import restored
from behavexplor.exchange.scenes import SceneFile
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import ADSError
from behavexplor.execution.start import fewest_workers, start_executor
from behavexplor.judge.specs import ERROR, SPECS
from behavexplor.report.marks import outcome


def importing(
    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")],
    *,
    ads: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: none)")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None,
    env: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: the scene's own)")] = None,
    trust: Annotated[str | None, tyro.conf.arg(metavar="DIGEST", help_behavior_hint="")] = None,
    unconfined: Switch = False,
    activation: GivenActivation = None,
) -> int:
    """Make a scenario from a scene that `export` wrote, even if it was changed by hand (docs/exchange.md).

    The scenario is printed as JSON. With a driving system, it is executed instead, and the verdict is printed.

    Args:
        file: An OpenSCENARIO XML file.
        ads: Driving system that executes the scenario, as for fuzz.
        out: Write the scenario to this JSON file, a new one.
        env: Environment of the scene; needed if it belongs to another package.
        trust: Allow the policy file with this digest ("sha256:...") to execute code on load.
        unconfined: Allow a driver that is not shipped with behavexplor to write files and use the network.
        activation: Function between the layers of a policy whose file holds weights alone, as for fuzz.
    """
    if out is not None and out.exists():
        raise InputError(f"{out} is there already, and is kept: name another file for --out")
    check_libraries()
    from behavexplor.exchange.scene_reading import read_scene  # noqa: PLC0415 - needs the extra `scenes`

    scene = read_scene(file)
    _check_environment(scene, env)
    plan, logical = road_of(scene.scenario, scene.environment, scene.env_config)
    scenario = restored(scene, logical)
    _check_road(file, scene, plan)
    if out is not None:
        write_json(out, scenario.to_dict())
    if ads is not None:
        # the conditions that a scenario states count more than those of its scene
        conditions: dict[str, Any] = {"env_config": scene.env_config, **scenario.conditions}
        target = Target(
            scene.environment,
            ads,
            confirm=False,
            activation=activation,
            trust=(trust,) if trust else (),
            unconfined=unconfined,
            **conditions,
        )
        return _execute(scenario, target, logical)
    if out is None:
        say(scenario.to_json())
    return OK


def _check_environment(scene: SceneFile, env: str | None) -> None:
    """Check that a file does not choose which code of other packages is loaded."""
    name = scene.environment
    is_foreign = bool(env_code(name))
    if env is not None and env != name:
        raise InputError(f"The scene belongs to the environment {name!r}, not to {env!r}")
    if env is None and is_foreign:
        raise InputError(f"The scene belongs to {name!r} of another package: pass --env {name} to load it")
    if scene.scenario is not None and scene.scenario.functional != name:
        raise InputError(f"The scene's scenario belongs to {scene.scenario.functional!r}, and the scene to {name!r}")


def _check_road(file: Path, scene: SceneFile, plan: Any) -> None:
    """Check that the road beside a scene is the environment's own, if it is there."""
    from behavexplor.exchange.opendrive import write_road  # noqa: PLC0415 - needs the extra `scenes`
    from behavexplor.exchange.xml_files import same_road  # noqa: PLC0415

    path = file.parent / scene.road_file
    if not scene.road_file or not path.is_file():
        say(wrapped(f"The file of the scene's road is not there, so it was not compared: {path}"), file=sys.stderr)
        return
    with tempfile.TemporaryDirectory() as folder:
        own = Path(folder) / "road.xodr"
        write_road(plan, path.stem, own)
        if not same_road(path, own):
            raise InputError(f"{path} is not the road of {scene.environment}, and a road cannot be changed by a scene")


def _execute(scenario: Scenario, target: Target, logical: LogicalScenario) -> int:
    """Execute a scenario, and print the outcome."""
    with start_executor(target, fewest_workers(target)) as executor:
        try:
            data = executor.submit(EXECUTE, scenario.to_json().encode()).result()
            result = judgment(data, None, SPECS).result
        except ADSError as error:
            say(sentence(f"The ADS failed: {ads_failure(error)['message']}"))
            say(f"Class: {ERROR}/{error.kind}")
            return OK
        except RuntimeError as error:
            return execution_failed(f"The scenario could not be executed: {error}")
    how = outcome(result.violated, result.end)
    say(wrapped(f"{logical.describe(scenario)}: {how} after {result.duration:.2f} s"))
    if result.violation_class is not None:
        say(f"Class: {result.violation_class}")
    return OK
