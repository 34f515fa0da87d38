"""What a campaign finds and leaves in its run folder before it begins."""

from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from behavexplor.campaign import opening
from behavexplor.campaign.config import LATEST, RUNS, CampaignConfig, stored_config
from behavexplor.campaign.store import Store
from behavexplor.errors import InputError
from behavexplor.execution.start import start_executor


def test_a_road_that_an_interruption_has_prevented_is_written_on_resuming(tmp_path, monkeypatch):
    road: Future[bytes] = Future()
    road.set_result(b"{}")
    made = {
        "start_executor": SimpleNamespace(runs_here=True, submit=lambda *_: road, shutdown=lambda **_: None),
        "check_ads": [],
        "logical_of_target": SimpleNamespace(name="highway-fast-v0", has_original=True, to_json=lambda: ""),
        "search_method": None,
    }
    for name, value in made.items():
        monkeypatch.setattr(opening, name, lambda *_, value=value, **__: value)
    config = CampaignConfig(env="highway-fast-v0", ads="constant:FASTER")
    Store.create(tmp_path / "run", config.to_yaml()).close()  # killed before the road was written
    with opening.opened(config, tmp_path / "run", 0, resume=True):
        assert (tmp_path / "run" / "road.json").read_text() == "{}"


def test_workers_that_a_batch_leaves_idle_are_said_to(tmp_path, monkeypatch):
    monkeypatch.setattr(opening, "start_executor", lambda target, _, *given: start_executor(target, 0, *given))
    for method, said in (("behavexplor", ["With --batch 2, 1 of 3 workers have nothing to do"]), ("uniform", [])):
        config = CampaignConfig(ads="constant", method=method, batch=2)
        with opening.opened(config, tmp_path / method, 3, resume=False) as ready:
            assert [one.partition(":")[0] for one in ready.warnings if "--batch" in one] == said


@pytest.fixture
def config():
    return CampaignConfig(env="lane-follow", ads="constant", method="uniform", budget="3")


def opened_run(config, folder, *, resume):
    with opening.opened(config, folder, 0, resume=resume) as ready:
        ready.campaign.run(lambda _: None)


def test_the_latest_run_is_the_one_that_began_or_went_on_last(tmp_path, monkeypatch, config):
    monkeypatch.chdir(tmp_path)
    for name, resume in (("first", False), ("second", False), ("first", True)):
        opened_run(config, RUNS / name, resume=resume)
        assert (RUNS / LATEST).readlink() == Path(name)


def test_a_budget_may_grow_and_one_that_is_used_up_is_refused(tmp_path, config):
    run = tmp_path / "run"
    opened_run(config, run, resume=False)
    with pytest.raises(InputError, match=f"--budget 2 is less than the 3 executions that {run} already has"):
        opened_run(replace(config, budget="2"), run, resume=True)
    for given, stored in (("6", "6"), ("5", "6"), ("2h", "2h"), ("90m", "2h")):
        with opening.opened(replace(config, budget=given), run, 0, resume=True):
            assert stored_config(run).unverified.budget == stored
    with opening.opened(replace(config, budget="5"), run, 0, resume=True):
        assert stored_config(run).unverified.budget == "5"  # of another kind
