"""Confirmation of failures in highway-env itself: which are tried, and what comes out; records do not depend on it."""

import json
import shutil
from concurrent.futures import Future
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from behavexplor.campaign.campaign import Campaign, ExecutionError
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.confirmation import FOLDER, OF_EACH_CLASS, difference, read_confirmations
from behavexplor.campaign.judgment import confirmation
from behavexplor.campaign.opening import opened
from behavexplor.campaign.run_summary import summarize
from behavexplor.campaign.store import Store
from behavexplor.commands import INTERRUPTED, OK, main
from behavexplor.commands.wording import counted
from behavexplor.execution.evaluator import EXECUTE, ORIGINAL
from behavexplor.execution.simulation import Simulation
from behavexplor.report.reading import read_run
from tests.envs.highway import strange

IDLE = CampaignConfig(env="merge-v0", ads="constant:IDLE", method="uniform", budget="12", seed=1)


def run(folder, config=IDLE, workers=0, resume=False, observe=lambda _: None):
    """Run a campaign with its confirmation; its records, and what was confirmed."""
    with opened(config, folder, workers, resume=resume) as ready:
        ready.campaign.run(lambda _: None)
        ready.campaign.confirm(observe)
    return records(folder), read_confirmations(folder)


def records(folder):
    with closing(Store.read(folder)) as store:
        return [(one.record.to_dict(), one.trace) for one in store.executions()]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "run"
    return folder, *run(folder)


def test_the_first_failures_of_each_class_are_confirmed(whole):
    classes = {}
    for record, _ in whole[1]:
        if record["violated"]:
            classes.setdefault(record["class"], []).append(record["id"])
    assert max(map(len, classes.values())) > OF_EACH_CLASS
    assert sorted(whole[2]) == sorted(number for some in classes.values() for number in some[:OF_EACH_CLASS])
    assert {one.state for one in whole[2].values()} == {"confirmed"}
    summary = summarize(whole[0])
    assert (summary.confirmed, summary.not_confirmed) == (len(whole[2]), ())
    assert f"was asked about {len(whole[2])} failures and confirms {len(whole[2])}" in read_run(whole[0]).confirmation


def test_the_report_counts_one_failure_as_one(tmp_path, whole):
    shutil.copytree(whole[0], tmp_path / "run")
    for file in sorted((tmp_path / "run/confirmations").iterdir())[1:]:
        file.unlink()
    assert "was asked about 1 failure and confirms 1." in read_run(tmp_path / "run").confirmation


def test_workers_and_confirmation_change_no_record(tmp_path, whole):
    assert run(tmp_path / "two", workers=2) == whole[1:]
    assert run(tmp_path / "none", replace(IDLE, confirm=False)) == (whole[1], {})


def test_an_interrupted_confirmation_goes_on(tmp_path, whole, monkeypatch):
    def interrupt(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "a", observe=interrupt)
    first = read_confirmations(tmp_path / "a")
    assert len(first) == 1
    original, executed = Simulation.run, []
    monkeypatch.setattr(Simulation, "run", lambda self, one: executed.append(one) or original(self, one))
    assert run(tmp_path / "a", resume=True) == whole[1:]
    assert len(executed) == len(whole[2]) - 1


def test_a_stopped_campaign_confirms_nothing_more(tmp_path):
    with opened(IDLE, tmp_path / "a", 0, resume=False) as ready:
        ready.campaign.run(lambda _: None)
        ready.campaign.confirm(lambda _: ready.campaign.stop())
        ready.campaign.confirm()
    assert len(read_confirmations(tmp_path / "a")) == 1


class Idler:
    """A driver in whose process highway-env's vehicles are 0.2 m beside those of the compiled engine."""

    vectorized = True

    def __init__(self):
        if Simulation.run.__name__ == "run":
            original = Simulation.run
            Simulation.run = lambda self, scenario: moved(original(self, scenario))

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.ones(len(observation), dtype=int), state


def moved(trace):
    return replace(trace, position=trace.position + 0.2)


@pytest.fixture
def _restored(monkeypatch):
    """Undo in the end what a driver has done to this process."""
    monkeypatch.setattr(Simulation, "run", Simulation.run)


@pytest.mark.usefixtures("_restored")
@pytest.mark.parametrize("workers", [0, 2])
def test_a_disagreement_is_shown_as_an_error_of_this_package(tmp_path, workers, capsys):
    folder = str(tmp_path / "run")
    arguments = ["--env", "merge-v0", "--ads", f"{__name__}:Idler", "--budget", "4", "--workers", str(workers)]
    assert main(["fuzz", *arguments, "--out", folder, "--unconfined"]) == OK
    words = "is an error of behavexplor and not of the driver: the compiled engine and highway-env disagree: the"
    said = capsys.readouterr()
    assert f"Confirming {counted(len(read_confirmations(tmp_path / 'run')), 'failure')} in highway-env" in said.err
    assert words in " ".join(said.out.split())
    assert {one.state for one in read_confirmations(tmp_path / "run").values()} == {"disagrees"}
    assert all(record["violated"] != ["error"] for record, _ in records(tmp_path / "run"))
    number = min(read_confirmations(tmp_path / "run"))
    for path in (tmp_path / "run" / FOLDER).iterdir():
        path.unlink()
    main(["replay", folder, str(number), "--out", str(tmp_path / "gif"), "--unconfined"])
    assert words in " ".join(capsys.readouterr().err.split())
    assert list(read_confirmations(tmp_path / "run")) == [number]
    for command in ("status", "records", "report"):
        assert main([command, folder]) == OK
        shown = " ".join(capsys.readouterr().out.split())
        assert command == "report" or "the vehicles are up to 0.2 m apart" in shown
    assert words in (tmp_path / "run" / "report.html").read_text()
    assert main(["triage", folder, "--workers", "0", "--quiet", "--unconfined"]) == OK
    assert words in " ".join(capsys.readouterr().out.split())


def test_an_interrupted_confirmation_says_how_many_failures_are_left(monkeypatch, tmp_path, capsys):
    confirmed = Campaign.confirm

    def interrupted(campaign, observe):
        confirmed(campaign, lambda done: (observe(done), campaign.stop()))

    monkeypatch.setattr(Campaign, "confirm", interrupted)
    arguments = ["--env", IDLE.env, "--ads", IDLE.ads, "--method", IDLE.method, "--budget", "12", "--seed", "1"]
    assert main(["fuzz", *arguments, "--workers", "0", "--out", str(tmp_path / "run")]) == INTERRUPTED
    said = " ".join(capsys.readouterr().err.split())
    count = int(said.partition("Confirming ")[2].split()[0])
    assert f"Not confirmed yet: {count - 1} of {count} failures" in said
    assert "resume with:" in said


class Remembering:
    """Always does the same until it has learned something else. It drives one episode at a time."""

    choice = 1

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.array([self.choice]), state


def test_a_driver_that_changes_is_not_taken_for_an_error_of_the_engine(tmp_path, monkeypatch):
    config = replace(IDLE, ads=f"{__name__}:Remembering", budget="1", unconfined=True)
    with opened(config, tmp_path, 0, resume=False) as ready:
        ready.campaign.run(lambda _: None)
        monkeypatch.setattr(Remembering, "choice", 4)
        ready.campaign.confirm()
    assert [one.state for one in read_confirmations(tmp_path).values()] == ["changes"]
    said = read_confirmations(tmp_path)[0].said_of(0)
    assert "not repeatable: the driver or the environment does not do the same twice" in said


@pytest.mark.parametrize(
    ("engine", "original", "state"),
    [
        ([0, 0, 0, 0], [1, 1], "disagrees"),
        ([0, 0, 0, 1], [1, 1], "changes"),  # which came out equal three times, as by chance
        ([0, 0, 0, 0], [1, 0], "changes"),
        ([], [0], "confirmed"),
    ],
)
def test_an_engine_disagrees_only_if_both_always_do_the_same(whole, engine, original, state):
    with closing(Store.read(whole[0])) as store:
        execution = store.execution(min(whole[2]))
    traces = execution.load_trace(), moved(execution.load_trace())
    answers = {EXECUTE: iter(engine), ORIGINAL: iter(original)}

    def submit(function, _):
        future = Future()
        future.set_result(traces[next(answers[function])].to_bytes())
        return future

    found = confirmation(SimpleNamespace(submit=submit), execution)
    assert found.state == state
    assert [*answers[EXECUTE], *answers[ORIGINAL]] == []


def test_failures_in_traffic_that_draws_elsewhere_are_said_to_be_not_repeatable(tmp_path, monkeypatch):
    monkeypatch.setattr(strange, "draws", np.random.default_rng(0))
    traffic = {"duration": 10, "other_vehicles_type": "tests.envs.highway.strange.Nervous"}
    config = replace(IDLE, env="highway-fast-v0", ads="constant:FASTER", env_config=traffic, budget="2")
    _, found = run(tmp_path / "run", config)
    assert {one.state for one in found.values()} == {"changes"}
    assert len(summarize(tmp_path / "run").not_confirmed) == len(found)


class Failing:
    """Fails in every decision."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise RuntimeError("a common one")


def test_a_failure_of_the_driver_itself_is_confirmed_too(tmp_path):
    config = replace(IDLE, ads=f"{__name__}:Failing", unconfined=True, budget="2")
    assert {one.state for one in run(tmp_path / "a", config)[1].values()} == {"confirmed"}


def test_what_cannot_be_executed_is_said(tmp_path, monkeypatch):
    def refuse(*_):
        raise RuntimeError("no more")

    monkeypatch.setattr(Simulation, "run", refuse)
    with pytest.raises(ExecutionError, match="A failure could not be confirmed: no more"):
        run(tmp_path / "a")
    assert read_confirmations(tmp_path / "a") == {}


def test_differences_have_words(whole):
    with closing(Store.read(whole[0])) as store:
        trace = store.execution(min(whole[2])).load_trace()
    failed = {"kind": "raised", "message": "no gap"}
    assert difference(trace, trace) is difference(failed, failed) is None
    for other, words in (
        (moved(trace), "up to 0.2 m apart"),
        (trace.until(5, "timeout"), "'timeout' in highway-env"),
        (replace(trace, partner=-1), "-1 in highway-env"),
        (replace(trace.until(5, trace.end), partner=trace.partner), "in highway-env"),
        (failed, "the driver failed in only one of them, or in another way: no gap"),
    ):
        assert words in str(difference(trace, other))


def test_a_confirmation_is_a_file_beside_the_run(whole):
    (path, *_) = sorted(Path(whole[0], FOLDER).iterdir())
    assert json.loads(path.read_text()) == {"state": "confirmed", "words": ""}
