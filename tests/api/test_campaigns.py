"""Campaigns from Python: the records are those of the command, and an interrupted one can be continued."""

import json
import signal
import subprocess
import sys

import gymnasium
import pytest

import behavexplor
from behavexplor.api.observers import observed
from behavexplor.campaign.config import Budget
from behavexplor.commands import main
from tests.drivers import Cruiser, cruiser

UNIFORM = {"method": "uniform", "seed": 5}


def faster(observation):
    """FASTER while the vehicle ahead is far away, or else IDLE."""
    assert observation.shape == (5, 5)
    return 3 if observation[1, 1] > 0.1 else 1


faster.env_config = {"duration": 8}


def breaks(trace):
    """Whether the episode is longer than 5 s."""
    return 5.0 - trace.duration


def lines(folder):
    """What `records` prints."""
    return [record.to_json() for record in behavexplor.open_run(folder).records]


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A run of an object in memory."""
    folder = tmp_path_factory.mktemp("api") / "run"
    return behavexplor.find_failures(Cruiser(), "intersection-straight", budget=12, out=folder, **UNIFORM)


def test_the_records_are_those_of_the_command(found, tmp_path):
    command = ["fuzz", "--ads", "tests.drivers:cruiser", "--workers", "0", "--unconfined", "--method", "uniform"]
    assert main([*command, "--budget", "12", "--seed", "5", "--out", str(tmp_path / "a"), "--quiet"]) == 0
    assert lines(found.folder) == lines(tmp_path / "a")
    by_name = behavexplor.find_failures("rule:hardened", budget=3, out=tmp_path / "b", **UNIFORM)
    assert (
        main(
            ["fuzz", "--ads", "rule:hardened", "--workers", "0", "--method", "uniform", "--budget", "3"]
            + ["--seed", "5", "--out", str(tmp_path / "c"), "--quiet"]
        )
        == 0
    )
    assert lines(by_name.folder) == lines(tmp_path / "c")


def test_a_function_of_one_observation_drives_here_and_from_the_command(tmp_path):
    run = behavexplor.find_failures(faster, "highway-fast-v0", budget=6, out=tmp_path / "a", confirm=False, **UNIFORM)
    assert run.config.ads == "tests.api.test_campaigns:faster"
    assert max(record.duration for record in run.records) <= 8.0
    command = ["fuzz", "--ads", "tests.api.test_campaigns:faster", "--env", "highway-fast-v0", "--method", "uniform"]
    command += ["--workers", "0", "--unconfined", "--no-confirm", "--budget", "6", "--seed", "5", "--quiet"]
    assert main([*command, "--out", str(tmp_path / "b")]) == 0
    assert lines(run.folder) == lines(tmp_path / "b")


def test_an_environment_object_gives_its_configuration(tmp_path):
    env = gymnasium.make("highway-fast-v0", config={"duration": 3, "lanes_count": 4})
    with pytest.warns(UserWarning, match="The driver always chooses"):
        run = behavexplor.find_failures(lambda _: 1, env, budget=2, out=tmp_path / "a", confirm=False)
    assert run.config.env == "highway-fast-v0"
    assert run.config.env_config.items() >= {"duration": 3, "lanes_count": 4}.items()
    assert run.config.ads == "in-memory:<lambda>"
    assert max(record.duration for record in run.records) <= 3.0
    wrapped = gymnasium.wrappers.FlattenObservation(env)
    with pytest.raises(behavexplor.InputError, match="FlattenObservation, which is not applied"):
        behavexplor.find_failures(lambda _: 1, wrapped)


def test_nothing_is_printed(found, tmp_path, capfd):
    behavexplor.find_failures(Cruiser(), "intersection-straight", budget=1, out=tmp_path / "a", **UNIFORM)
    assert capfd.readouterr() == ("", "")


def test_progress_is_shown_where_it_is_asked_for(tmp_path, capfd):
    seen = []
    behavexplor.find_failures(cruiser, budget=2, out=tmp_path / "a", progress=seen.append, **UNIFORM)
    assert seen[-1].executions == 2
    with observed(True, Budget.parse("2")) as show:
        show(seen[-1])
    assert "2 executions, " in capfd.readouterr().err


def test_ctrl_c_leaves_a_run_that_resumes(found, tmp_path, monkeypatch):
    monkeypatch.setattr("behavexplor.campaign.campaign.COMMIT_SECONDS", 0.0)
    presses = iter([lambda: signal.raise_signal(signal.SIGINT)])

    def interrupt(progress):
        if progress.executions >= 2:
            next(presses, lambda: None)()

    arguments = {"budget": 5, "out": tmp_path / "a", "batch": 1, **UNIFORM}
    with pytest.raises(behavexplor.Interrupted, match="open_run") as stopped:
        behavexplor.find_failures(Cruiser(), "intersection-straight", progress=interrupt, **arguments)
    run = behavexplor.open_run(stopped.value.folder)
    assert 2 <= len(run) < 5
    with pytest.raises(behavexplor.InputError, match="an object in memory"):
        run.resume()
    with pytest.raises(behavexplor.InputError, match="is a run of 'in-memory:Cruiser', not of"):
        run.resume(lambda _: 1)
    run.resume(Cruiser())
    scenarios = [record.scenario for record in run.records]
    assert scenarios == [record.scenario for record in found.records[:5]]


def test_a_campaign_stops_after_enough_failures(found, tmp_path):
    run = behavexplor.find_failures(
        Cruiser(), "intersection-straight", budget=12, stop_after=2, out=tmp_path / "a", **UNIFORM
    )
    assert run.summary.failed == 2
    assert not run.summary.complete
    assert run.records[-1].failed
    assert lines(run.folder) == lines(found.folder)[: len(run)]
    run.resume()
    assert lines(run.folder) == lines(found.folder)


def test_a_requirement_in_memory_is_judged(tmp_path):
    run = behavexplor.find_failures(cruiser, budget=3, specs=[breaks], out=tmp_path / "a", **UNIFORM)
    assert run.config.specs == ("tests.api.test_campaigns:breaks",)
    assert all("breaks" in record.violated for record in run.records if record.duration > 5.0)
    with pytest.raises(behavexplor.InputError, match="at the top level of a module or notebook"):
        behavexplor.find_failures(cruiser, specs=[lambda trace: 1.0])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"specs": breaks}, "specs must be a list, such as"),
        ({"specs": "my_specs:brakes"}, "specs must be a list, such as .*my_specs:brakes"),
        ({"env_config": "config.yaml"}, "env_config must be a mapping from keys to values, got 'config.yaml'"),
    ],
)
def test_lone_requirements_and_names_of_files_are_refused(given, message):
    with pytest.raises(behavexplor.InputError, match=message):
        behavexplor.find_failures(cruiser, budget=3, **given)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"driver": cruiser, "workers": 2}, "workers=2 needs a driver that other processes can load"),
        ({"driver": Cruiser}, "is a class: give an instance of it"),
        ({"driver": 3}, "a function of one observation, an object with a predict method"),
        ({"driver": "ruler"}, "did you mean 'rule'"),
        ({"driver": cruiser, "env": 3}, "must be an id or an environment of gymnasium"),
        ({"driver": cruiser, "budget": 0}, "neither a number of executions"),
        ({"driver": cruiser, "metod": "uniform"}, "metod"),
    ],
)
def test_wrong_arguments_are_refused_in_one_sentence(arguments, message, tmp_path):
    with pytest.raises(behavexplor.InputError, match=message):
        behavexplor.find_failures(**arguments, out=tmp_path / "a")


def test_rates_are_those_of_the_command(tmp_path, capsys):
    rates = behavexplor.evaluate(cruiser, "intersection-straight", scenarios=20, seed=1)
    command = ["evaluate", "--ads", "tests.drivers:cruiser", "--workers", "0", "--unconfined", "--scenarios", "20"]
    assert main([*command, "--seed", "1", "--quiet", "--json", str(tmp_path / "rates.json")]) == 0
    counts = json.loads((tmp_path / "rates.json").read_text())
    assert {name: counts[name] for name in rates.counts} == dict(rates.counts)


def test_the_interface_is_imported_when_it_is_used():
    code = (
        "import sys, behavexplor; heavy = {'torch', 'sklearn', 'highway_env', 'pandas', 'numba', 'pydantic', 'PIL'};"
        "print(sorted(heavy & set(sys.modules)), behavexplor.Run.__name__, 'torch' in sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[] Run False"
    assert set(behavexplor.__all__) <= set(dir(behavexplor))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        behavexplor.nothing  # noqa: B018


@pytest.mark.filterwarnings("ignore:The driver always chooses")
@pytest.mark.parametrize(("env", "method"), [("merge-v0", "uniform"), ("lane-follow", "behavexplor")])
def test_the_search_method_that_is_not_chosen_depends_on_the_environment(env, method, tmp_path):
    run = behavexplor.find_failures("constant:IDLE" if "-v" in env else "constant", env, budget=1, out=tmp_path / "run")
    assert run.config.method == method
    chosen = behavexplor.find_failures(
        "constant:IDLE" if "-v" in env else "constant", env, budget=1, method="random", out=tmp_path / "other"
    )
    assert chosen.config.method == "random"
