"""The commands on a policy in the environment where it was trained."""

import json
import shutil
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from gymnasium.spaces import Box, Discrete

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.store import Store
from behavexplor.commands import evaluate, main
from behavexplor.data.trace import Trace
from tests.ads.sb3.models import make_model

ENV = ["--env", "merge-v0"]
QUICK = ["--workers", "0", "--quiet"]


def stored(folder):
    with closing(Store.read(folder)) as store:
        return list(store.executions())


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stock") / "run"
    config = folder.parent / "merge.yaml"
    config.write_text(yaml.safe_dump({"policy_frequency": 2}))
    arguments = ["fuzz", *ENV, "--ads", "constant:FASTER", "--budget", "8", "--seed", "3", "--out", str(folder)]
    assert main([*arguments, "--env-config", str(config), *QUICK]) == 0
    return folder


def test_replay_says_what_the_driver_decided(run, tmp_path, capsys):
    execution = next(one for one in stored(run) if one.record.failed)
    assert main(["replay", str(run), str(execution.id), "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert f"The driver's decisions: {len(execution.load_trace().action_frame)} x FASTER" in text
    assert "lines" not in text  # merge-v0 has neither requirement
    assert "destination" not in text


def test_a_campaign_is_stored_with_the_whole_configuration(run):
    records = [execution.record for execution in stored(run)]
    assert len(records) == 8
    assert all(record.scenario["config"]["policy_frequency"] == 2 for record in records)
    assert all(record.scenario["highway-env"] for record in records)
    assert any(record.violated == ("collision",) for record in records)
    assert yaml.safe_load((run / "config.yaml").read_text())["env_config"] == {"policy_frequency": 2}


def test_the_same_seed_gives_the_same_records(run, tmp_path):
    again = tmp_path / "again"
    config = run.parent / "merge.yaml"
    arguments = ["fuzz", *ENV, "--ads", "constant:FASTER", "--budget", "8", "--seed", "3", "--out", str(again)]
    assert main([*arguments, "--env-config", str(config), "--quiet", "--workers", "2"]) == 0
    first, second = ([(one.record, one.trace) for one in stored(folder)] for folder in (run, again))
    assert first == second


def test_a_failure_is_drawn_and_reproduced(run, capsys):
    assert main(["replay", str(run), "0"]) == 0
    assert "The execution was reproduced" in capsys.readouterr().out
    assert (run / "replays" / "000000.png").stat().st_size > 5000


def test_a_driver_that_avoids_a_crash_is_drawn(run, tmp_path, capsys):
    folder = shutil.copytree(run, tmp_path / "run")
    assert main(["triage", str(folder), *QUICK]) == 0
    assert "preventable" in capsys.readouterr().out
    number = next(one.id for one in stored(folder) if (folder / "witnesses" / f"{one.id:06d}.json").is_file())
    assert main(["replay", str(folder), str(number), "--avoided"]) == 0
    assert f"Execution {number} without its collision" in capsys.readouterr().out
    assert (folder / "replays" / f"{number:06d}-avoided.png").stat().st_size > 5000
    witness = folder / "witnesses" / f"{number:06d}.json"
    witness.write_text(json.dumps({"name": "careful", "begin": 0, "frequency": 20, "commands": [[0, 0]]}))
    assert main(["replay", str(folder), str(number), "--avoided"]) == 2
    assert "belongs to an environment of another kind" in capsys.readouterr().err


def test_the_report_shows_the_road(run):
    assert main(["report", str(run)]) == 0
    page = (run / "report.html").read_text()
    assert "R1/" in page
    assert '"spans"' in page


def test_a_run_goes_on_where_it_ended(run, capsys):
    assert main(["fuzz", "--resume", str(run), "--budget", "9", *QUICK]) == 0
    assert "9 executions" in capsys.readouterr().out


@pytest.mark.parametrize("method", ["random", "avfuzzer", "samota", "nsga2", "map-elites", "novelty-search", "uniform"])
def test_every_search_method_runs_on_draws(method, tmp_path):
    out = tmp_path / "run"
    arguments = ["fuzz", *ENV, "--ads", "constant:SLOWER", "--method", method, "--budget", "12"]
    assert main([*arguments, "--out", str(out), *QUICK]) == 0
    records = [execution.record for execution in stored(out)]
    assert len({json.dumps(record.scenario["draws"]) for record in records}) == 12


def test_aiming_needs_scripted_vehicles(tmp_path, capsys):
    out = tmp_path / "run"
    assert main(["fuzz", *ENV, "--ads", "constant:IDLE", "--method", "encounters", "--out", str(out), *QUICK]) == 2
    assert "needs one of the environments with scripted vehicles" in capsys.readouterr().err
    assert not out.exists()


def test_rates_stand_beside_those_of_constant_drivers(capsys):
    assert main(["evaluate", *ENV, "--ads", "constant:SLOWER", "--scenarios", "6", *QUICK]) == 0
    table = capsys.readouterr().out
    heading, columns, *_ = table.splitlines()
    assert heading == "6 scenarios of merge-v0, with 95 % intervals:"
    assert columns.strip() == "constant:SLOWER"
    beside = table.partition("Beside it, in 6 scenarios:\n")[2].splitlines()[1:]
    assert [line[:13].strip() for line in beside] == ["careful", "always SLOWER", "always IDLE", "always FASTER"]
    assert max(map(len, table.splitlines())) <= 60
    assert "destination" not in table


def test_a_policy_is_tested_where_it_was_trained(tmp_path, capsys):
    make_model("PPO", Box(-np.inf, np.inf, (5, 5)), Discrete(5)).save(tmp_path / "model.zip")
    (tmp_path / "model.yaml").write_text(yaml.safe_dump({"env": "merge-v0", "config": {"policy_frequency": 2}}))
    ads = ["--ads", str(tmp_path / "model.zip")]
    assert main(["evaluate", *ads, "--scenarios", "3", "--no-controls", "--unconfined", *QUICK]) == 0
    assert "3 scenarios of merge-v0" in capsys.readouterr().out
    assert main(["fuzz", *ads, "--budget", "2", "--unconfined", "--out", str(tmp_path / "run"), *QUICK]) == 0
    assert yaml.safe_load((tmp_path / "run/config.yaml").read_text())["env"] == "merge-v0"


def test_a_rate_in_wide_traffic_stands_beside_the_one_in_default_traffic(tmp_path, capsys):
    file = tmp_path / "rates.json"
    arguments = ["evaluate", *ENV, "--ads", "constant:SLOWER", "--scenarios", "4", "--traffic", "wide", "--no-controls"]
    assert main([*arguments, "--json", str(file), *QUICK]) == 0
    assert "in default traffic" in capsys.readouterr().out
    assert list(json.loads(file.read_text())["beside"]) == ["in default traffic"]


def test_a_stored_failure_is_played_by_plain_highway_env(run):
    file = next(Path(run / "failures").glob("*.json"))
    scenario = json.loads(file.read_text())["scenario"]
    assert scenario["functional"] == "merge-v0"
    assert scenario["draws"]["_make_vehicles"]
    store = Store.read(run)
    trace: Trace = store.execution(int(file.stem.split("-")[0])).load_trace()
    store.close()
    assert trace.signals["crashed"][-1] == 1


def test_search_methods_are_compared_in_a_stock_environment(tmp_path, capsys):
    experiment = {
        "methods": {"Uniform": {"method": "uniform"}, "BehAVExplor": {"method": "behavexplor"}},
        "envs": ["merge-v0"],
        "ads": ["constant:IDLE"],
        "seeds": 1,
        "budget": 4,
        "traffic": "wide",
        "confirm": False,
    }
    file = tmp_path / "merge.yaml"
    file.write_text(yaml.safe_dump(experiment))
    assert main(["bench", str(file), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    assert "Number of classes of failures at fault" in capsys.readouterr().out
    config = yaml.safe_load((tmp_path / "out/runs/merge-v0/constant-IDLE/Uniform/1/config.yaml").read_text())
    assert (config["traffic"], config["confirm"]) == ("wide", False)


def test_a_campaign_may_do_without_confirmation(tmp_path):
    folder = tmp_path / "run"
    arguments = ["fuzz", *ENV, "--ads", "constant:FASTER", "--budget", "2", "--no-confirm", "--out", str(folder)]
    assert main([*arguments, *QUICK]) == 0
    assert yaml.safe_load((folder / "config.yaml").read_text())["confirm"] is False
    assert main(["fuzz", "--resume", str(folder), "--budget", "3", *QUICK]) == 0


class Straight:
    """Steers straight on."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 1)), state


def test_controls_that_cannot_drive_in_an_environment_are_left_out(tmp_path, capsys):
    (tmp_path / "short.yaml").write_text("duration: 2\n")
    arguments = ["evaluate", "--env", "racetrack-v0", "--ads", f"{__name__}:Straight", "--scenarios", "1"]
    assert main([*arguments, "--env-config", str(tmp_path / "short.yaml"), "--workers", "0", "--unconfined"]) == 0
    shown = capsys.readouterr()
    assert "Without the control 'always SLOWER', which cannot drive here: " in shown.err
    assert "always SLOWER" not in shown.out
    assert "Straight" in shown.out


def test_a_rate_of_a_control_itself_is_decided(tmp_path, capsys):
    """The control took the place of the driver, and the exit code said "below" of what was not decided."""
    arguments = ["evaluate", "--env", "roundabout-v0", "--ads", "careful", "--scenarios", "5", "--workers", "0"]
    assert main([*arguments, "--below", "0.001", "--json", str(tmp_path / "a.json")]) == 4
    assert "Not decided: collision in none of 5 scenarios" in capsys.readouterr().out
    found = json.loads((tmp_path / "a.json").read_text())
    assert found["decision"]["verdict"] == ""
    assert set(found["beside"]) == {"always SLOWER", "always IDLE", "always FASTER"}


def test_a_driver_of_the_same_name_as_a_control_is_shown_beside_it(monkeypatch):
    def evaluated(target, *_, **__):
        return (None, target.ads, False)

    monkeypatch.setattr(evaluate, "_evaluated", evaluated)
    monkeypatch.setattr(evaluate, "_beside", lambda target, *_, **__: {"careful": replace(target, ads="careful")})
    run = evaluate._Run(1, 0, 0, True, None, None)
    config = CampaignConfig(env="roundabout-v0", ads="policies/careful")
    found = evaluate._evaluations(config, run, controls=True)
    assert found == {"policies/careful": "policies/careful", "careful": "careful"}


def test_a_driver_that_leaves_the_road_is_reported_and_drawn(tmp_path, capsys):
    (tmp_path / "short.yaml").write_text("duration: 8\n")
    arguments = ["fuzz", "--env", "racetrack-v0", "--ads", f"{__name__}:Straight", "--budget", "2", "--unconfined"]
    more = ["--env-config", str(tmp_path / "short.yaml"), "--out", str(tmp_path / "run"), *QUICK]
    assert main([*arguments, *more]) == 0
    (first, *_) = [execution for execution in stored(tmp_path / "run") if "lines" in execution.record.violated]
    assert main(["report", str(tmp_path / "run")]) == 0
    assert first.record.violation_class in (tmp_path / "run" / "report.html").read_text()
    assert main(["replay", str(tmp_path / "run"), str(first.id)]) == 0
    assert "was reproduced" in capsys.readouterr().out
