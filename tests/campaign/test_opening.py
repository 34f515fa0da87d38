"""What a campaign finds and leaves in its run folder before it begins."""

from concurrent.futures import Future
from types import SimpleNamespace

from behavexplor.campaign import opening
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.store import Store
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
