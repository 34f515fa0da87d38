"""Experiments on clusters: the tables are those of one machine. Ray takes its time to start."""

import csv
import json
import secrets
from threading import Timer

import pytest

from behavexplor.bench.experiment import read_experiment
from behavexplor.bench.runs import ExperimentRunner
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, OK, main

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]  # of Ray's own libraries

EXPERIMENT = {
    "envs": ["intersection-straight"],
    "ads": ["rule:apollo-like"],
    "methods": {"BehAVExplor": {"config": "paper"}, "Random": {"method": "random"}, "Uniform": {"method": "uniform"}},
    "seeds": 3,
    "budget": 40,
    "baseline": "Uniform",
}  # as configs/experiments/quick.yaml
MEASURED = ("executing_s", "analysing_s")
BY_THE_CLOCK = ("times", "violations-equal-time")  # tables that depend on how long the analysis took


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The experiment on this machine."""
    folder = tmp_path_factory.mktemp("alone")
    return bench(folder / "out", "--jobs", "2")


def bench(out, *flags):
    file = out.parent / "quick.yaml"
    file.write_text(json.dumps(EXPERIMENT))
    assert main(["bench", str(file), "--out", str(out), "--quiet", *flags]) == OK
    return out


def tables(out):
    """Everything in the tables but what a clock has measured."""
    found = {path.name: path.read_text() for path in (out / "tables").iterdir() if path.stem not in BY_THE_CLOCK}
    with (out / "summaries.csv").open() as file:
        rows = [{key: value for key, value in row.items() if key not in MEASURED} for row in csv.DictReader(file)]
    return found, rows


def records(out):
    found = {}
    for path in sorted(out.rglob("campaign.db")):
        store = Store.read(path.parent)
        found[str(path.parent.relative_to(out))] = [record.to_json() for record in store.records()]
        store.close()
    return found


@pytest.fixture(autouse=True, scope="module")
def token():
    """No cluster that others can use, and no file of Ray's at home; it reads this when it is imported."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_AUTH_MODE", "token")
        patch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
        pytest.importorskip("ray")
        yield


def test_two_nodes_give_the_tables_of_one_machine(alone, tmp_path):
    out = bench(tmp_path / "out", "--jobs", "2", "--cluster", "ray")
    assert records(out) == records(alone)
    assert tables(out) == tables(alone)


def test_what_was_executed_is_kept_when_the_experiment_is_stopped(tmp_path):
    (tmp_path / "long.yaml").write_text(
        json.dumps({**EXPERIMENT, "methods": {"Uniform": {"method": "uniform"}}, "budget": 100_000})
    )
    runs = read_experiment(str(tmp_path / "long.yaml")).runs()
    runner = ExperimentRunner(runs, tmp_path / "out", 2, 0, "ray")
    stopping = Timer(15.0, runner.stop)  # after both campaigns have begun
    stopping.start()
    progress = runner.run(lambda _: None)
    assert (progress.finished, progress.failed) == (0, {})
    assert sorted(len(found) > 0 for found in records(tmp_path / "out").values()) == [True, True]


def test_a_cluster_that_is_none_is_refused(tmp_path, capsys):
    (tmp_path / "quick.yaml").write_text(json.dumps(EXPERIMENT))
    assert main(["bench", str(tmp_path / "quick.yaml"), "--cluster", "slurm"]) == BAD_INPUT
    assert "Unknown cluster" in capsys.readouterr().err
