"""Runs and campaigns from Python, as far as nothing is driven."""

import pytest

import behavexplor
from behavexplor.ads.in_memory import GivenDriver
from behavexplor.api.observers import observed
from behavexplor.campaign.config import Budget, CampaignConfig
from behavexplor.campaign.progress import ClassSummary, Progress
from behavexplor.campaign.store import Store
from tests.campaign.test_store import execution


@pytest.fixture
def run(tmp_path):
    """A run with failures of two classes."""
    store = Store.create(tmp_path / "run", CampaignConfig(budget="9").to_yaml())
    for number, kind in enumerate(["R2/a", "R1/b", None, "R1/b"]):
        store.add(execution(number, ("lines",) if kind else (), kind))
    store.commit()
    store.close()
    return behavexplor.open_run(tmp_path / "run")


def test_a_larger_budget_counts_after_an_interruption_too(run, monkeypatch):
    def interrupted(config, folder, *_, **__):
        (folder / "config.yaml").write_text(config.to_yaml())
        raise behavexplor.Interrupted(folder)

    monkeypatch.setattr("behavexplor.api.run.conduct", interrupted)
    with pytest.raises(behavexplor.Interrupted):
        run.resume(budget=12)
    assert run.config.budget == "12"


def test_classes_need_no_summary_of_the_same_moment(run, monkeypatch):
    monkeypatch.setattr("behavexplor.api.run.summarize", None)  # a campaign may write between two readings
    assert run.classes == {"R1/b": [1, 3], "R2/a": [0]}


def test_no_failures_are_minimized_if_none_are_given(run, monkeypatch):
    monkeypatch.setattr("behavexplor.api.run.RunMinimization", None)
    assert run.minimize([]) == []


def test_progress_is_said_once(capfd):
    with observed(True, Budget(executions=10)) as show:
        show(Progress(executions=4, failed=1, classes={"R1/b": ClassSummary("R1/b", 1, 0, 0)}))
    assert "4 executions, 1 failed in 1 class" in (said := capfd.readouterr().err)
    assert "4 executions, 4 executions" not in said


@pytest.mark.parametrize("name", ["budget", "method", "specs"])
def test_an_evaluation_refuses_what_it_would_ignore(name):
    with pytest.raises(behavexplor.InputError, match=f"has no use for {name}"):
        behavexplor.evaluate(len, **{name: "x"})


def test_a_campaign_cannot_stop_after_no_failure(tmp_path):
    with pytest.raises(behavexplor.InputError, match="stop_after=0 must be at least 1"):
        behavexplor.find_failures(len, stop_after=0, out=tmp_path / "a")


@pytest.mark.parametrize("workers", [-1, 65, "2"])
def test_a_number_of_workers_that_there_cannot_be_is_refused(tmp_path, workers):
    with pytest.raises(behavexplor.InputError, match=f"workers={workers!r} must lie between 0 and 64"):
        behavexplor.find_failures("rule", workers=workers, out=tmp_path / "a")


def test_a_comparison_checks_both_drivers_before_the_first_one_drives(tmp_path, monkeypatch):
    monkeypatch.setattr("behavexplor.api.comparing.conduct", None)
    with pytest.raises(behavexplor.InputError, match="workers=2 needs a driver"):
        behavexplor.compare("rule", len, workers=2, out=tmp_path / "a")


def test_workers_that_a_driver_in_memory_cannot_have_are_refused(tmp_path):
    Store.create(tmp_path / "run", CampaignConfig(ads="in-memory:len").to_yaml()).close()
    run = behavexplor.open_run(tmp_path / "run", GivenDriver("in-memory:len", len))
    for examine in (run.triage, run.minimize):
        with pytest.raises(behavexplor.InputError, match="workers=4 needs a driver"):
            examine(workers=4)
