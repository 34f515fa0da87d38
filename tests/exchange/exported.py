"""What the tests of exchanged scenes share: schemas, campaigns, and the repetition of an imported scene."""

from pathlib import Path

import numpy as np
import scenariogeneration
from lxml import etree

from behavexplor.campaign.judgment import judgment
from behavexplor.campaign.store import Execution, Store
from behavexplor.commands import main
from behavexplor.commands.roads import road_of
from behavexplor.data.trace import Trace
from behavexplor.exchange.restoring import restored
from behavexplor.exchange.scene_reading import read_scene
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.specs import SPECS

SCHEMAS = Path(scenariogeneration.__file__).parent.parent / "schemas"


def schema_errors(path, revision="1_2"):
    """The errors of an exported file against the published schema of its standard."""
    name = f"OpenSCENARIO_{revision}.xsd" if path.suffix == ".xosc" else "opendrive_17_core.xsd"
    schema = etree.XMLSchema(etree.parse(SCHEMAS / name))
    schema.validate(etree.parse(path))
    return [f"{path.name}, line {error.line}: {error.message}" for error in schema.error_log]


def fuzz(folder, env, ads, budget):
    """Run a campaign."""
    arguments = [
        "--env",
        env,
        "--ads",
        ads,
        "--budget",
        str(budget),
        "--workers",
        "0",
        "--no-confirm",
        "--quiet",
        "--unconfined",
    ]
    assert main(["fuzz", *arguments, "--method", "uniform", "--out", str(folder)]) == 0
    return folder


def failures(run):
    """The failed executions of a run."""
    store = Store.read(run)
    found = [store.execution(record.id) for record in store.records() if record.failed and record.error is None]
    store.close()
    return found


def imported(path):
    """The scenario of an exported file."""
    scene = read_scene(path)
    _, logical = road_of(scene.scenario, scene.environment, scene.env_config)
    return restored(scene, logical)


def repeated(scenarios, env, ads):
    """The traces of scenarios, executed in this process."""
    simulation = Simulation(env, ads)
    traces = dict(simulation.run_all(scenarios))
    return [traces[i] for i in range(len(scenarios))]


def difference(execution: Execution, again: Trace):
    """How an imported scene differs from what was exported: greatest distance [m], and verdicts that are not equal."""
    recorded = execution.load_trace()
    result = judgment(again.to_bytes(), None, SPECS).result
    said = (result.violated, result.violation_class)
    expected = (execution.record.violated, execution.record.violation_class)
    if recorded.position.shape != again.position.shape:
        return np.inf, said, expected
    return float(np.abs(recorded.position - again.position).max()), said, expected
