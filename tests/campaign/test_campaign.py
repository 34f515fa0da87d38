"""Campaigns: the same records whatever executes them, nothing counted that is not stored, and resumption."""

import sqlite3
import time
from collections import Counter
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import closing
from functools import cache

import numpy as np
import pytest

from behavexplor.behavior.novelty import NOVELTY_THRESHOLD, NoveltyArchive
from behavexplor.campaign.campaign import Campaign, ExecutionError, search_method
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.folder_format import DATABASE
from behavexplor.campaign.judgment import judgment
from behavexplor.campaign.store import Store
from behavexplor.campaign.uniform_rate import UniformRate
from behavexplor.data.scenario import parse_scenario
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError
from behavexplor.execution.executor import ADSError
from behavexplor.fuzz.methods import METHODS
from behavexplor.judge.classes import violation_class
from behavexplor.judge.fault import contact_fault
from behavexplor.judge.specs import judge
from tests.fakes import simulate

LOGICAL = IntersectionStraightEnv.logical


class FakeExecutor(Executor):
    """Runs the ten-line simulator in place of what is submitted."""

    runs_here = True

    def __init__(self, executed=None, fail_at=None, room=0):
        self.executed = [] if executed is None else executed
        self.fail_at = fail_at
        self.room = room

    def submit(self, _evaluate, scenario):
        future = Future()
        self.executed.append(scenario)
        if len(self.executed) - 1 == self.fail_at:
            future.set_exception(RuntimeError("the ADS has lost its mind\nand more"))
        else:
            future.set_result(simulate(parse_scenario(scenario.decode())).to_bytes())
        return future


class FakeThreads(ThreadPoolExecutor):
    """The same in threads, which finish in any order."""

    runs_here = False
    room = 7

    def submit(self, _evaluate, scenario):
        return super().submit(lambda: simulate(parse_scenario(scenario.decode())).to_bytes())


class OftenLate(FakeExecutor):
    """Executes every fourth candidate only when its result is waited for."""

    runs_here = False

    def submit(self, evaluate, scenario):
        number = len(self.executed)
        future = super().submit(evaluate, scenario)
        return Late(future) if number % 4 == 0 else future


class Late(Future):
    """A future that is done once its result has been asked for."""

    def __init__(self, future):
        super().__init__()
        self.future = future

    def result(self, timeout=None):
        if not self.done():
            self.set_result(self.future.result())
        return super().result(timeout)


def run(folder, executor=None, observe=lambda _: None, **config):
    config = CampaignConfig(**{"budget": "40", "seed": 3, **config})
    method = search_method(config, LOGICAL)
    store = Store.reopen(folder) if folder.exists() else Store.create(folder, config.to_yaml())
    campaign = Campaign(config, method, LOGICAL, store, executor or FakeExecutor())
    try:
        campaign.run(observe)
    finally:
        records = [execution.record.to_dict() for execution in store.executions()]
        store.close()
    return records


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The records of an uninterrupted campaign, by search method."""
    return cache(lambda method: run(tmp_path_factory.mktemp("whole") / "run", method=method))


def test_candidates_are_judged_while_an_older_one_is_waited_for(tmp_path, monkeypatch, recorded):
    waited, judged, expected = [], [], recorded("random")
    result = Late.result
    monkeypatch.setattr(Late, "result", lambda late: waited.append(len(judged)) or result(late))
    monkeypatch.setattr(
        "behavexplor.campaign.campaign.judgment", lambda *given: judged.append(given) or judgment(*given)
    )
    assert run(tmp_path / "run", OftenLate(), method="random") == expected
    assert len(judged) == 40
    assert waited[0] == 6  # of the eight in flight, all but the two late ones had been judged before the first wait


def test_an_error_of_a_candidate_that_was_executed_early_comes_in_its_turn(tmp_path):
    with pytest.raises(ExecutionError, match="Execution 6 could not be carried out"):
        run(tmp_path / "run", OftenLate(fail_at=6), method="random")
    store = Store.reopen(tmp_path / "run")
    assert len(store) == 6
    store.close()


@pytest.mark.parametrize("method", METHODS)
def test_the_same_seed_gives_the_same_records(tmp_path, method, recorded):
    records = recorded(method)
    assert [record["id"] for record in records] == list(range(40))
    assert run(tmp_path / "b", method=method) == records
    assert run(tmp_path / "c", method=method, seed=4, budget="10") != records[:10]


@pytest.mark.parametrize(("method", "early"), [("uniform", 30), ("nsga2", 20), ("map-elites", 20), ("random", 8)])
def test_candidates_that_need_no_result_are_executed_early(tmp_path, method, early, recorded):
    executed, first_tell = FakeExecutor(room=1), []

    class Told(Store):
        def add(self, execution):
            first_tell.append(len(executed.executed))
            super().add(execution)

    config = CampaignConfig(budget="40", seed=3, method=method)
    store = Told.create(tmp_path / "run", config.to_yaml())
    campaign = Campaign(config, search_method(config, LOGICAL), LOGICAL, store, executed)
    submit = executed.submit

    def submit_until_full(*given):
        executed.room = 29 - len(executed.executed)
        return submit(*given)

    executed.submit = submit_until_full
    campaign.run(lambda _: None)
    assert [execution.record.to_dict() for execution in store.executions()] == recorded(method)
    store.close()
    assert first_tell[0] == early


def test_records_do_not_depend_on_the_executor(tmp_path, recorded):
    with FakeThreads(4) as threads:
        assert run(tmp_path / "b", threads) == recorded("behavexplor")


def test_each_record_says_what_happened(recorded):
    for record in recorded("behavexplor"):
        assert {"id", "origin", "parent", "end", "violated", "degree", "degrees", "novelty", "novel"} <= record.keys()
        assert 0 <= record["novelty"] <= 1
        assert record["degree"] == pytest.approx(sum(record["degrees"].values()))
        assert set(record["violated"]) <= set(record["degrees"])
        LOGICAL.check(ScriptedScenario.from_dict(record["scenario"]))


def test_failures_are_recorded_with_their_class_and_fault(tmp_path):
    seen = []
    records = run(tmp_path / "a", observe=seen.append, method="uniform", budget="60")
    store = Store.read(tmp_path / "a")
    kinds = Counter()
    for execution in store.executions():
        record, trace = execution.record.to_dict(), execution.load_trace()
        if not record["violated"]:
            assert not {"class", "fault"} & record.keys()
            continue
        kind = violation_class(trace, judge(trace).violated)
        assert record["class"] == (kind.id if kind else "R1")  # the fake goes on driving after a contact
        assert record.get("fault") == (contact_fault(trace) if record["class"].startswith("R1") else None)
        kinds[record["class"]] += 1
    store.close()
    assert len(kinds) > 1
    assert {kind: one.count for kind, one in seen[-1].classes.items()} == kinds
    for kind, one in seen[-1].classes.items():
        assert one.first == next(r["id"] for r in records if r.get("class") == kind)
    first = [r["id"] for r in records if r["violated"][:1] == ["collision"]]
    assert seen[-1].examples["collision"] == tuple(first[:3])
    assert [one.count for one in seen[-1].largest_first] == sorted(kinds.values(), reverse=True)
    newest = max(min(r["id"] for r in records if r.get("class") == kind) for kind in kinds)
    assert seen[-1].last["class"] == newest


def test_an_error_is_a_class_of_its_own(tmp_path):
    class Failing(FakeExecutor):
        def submit(self, evaluate, scenario):
            future = super().submit(evaluate, scenario)
            if len(self.executed) % 5:
                return future
            failed = Future()
            failed.set_exception(ADSError("invalid", "predict must return numbers"))
            return failed

    records = run(tmp_path / "a", Failing(), method="uniform", budget="20")
    assert [record["class"] for record in records if "error" in record] == ["error/invalid"] * 4


def test_a_longer_budget_only_adds(tmp_path, recorded):
    assert recorded("behavexplor")[:20] == run(tmp_path / "a", budget="20")


def test_candidates_in_flight_are_bounded_by_the_batch(tmp_path):
    """With a batch of 1 the second candidate is asked for after the first was told, as in the paper's loop."""
    in_flight = []

    class Watched(FakeExecutor):
        def submit(self, evaluate, scenario):
            in_flight.append(len(self.executed) - told[0])
            return super().submit(evaluate, scenario)

    for batch in (1, 5):
        in_flight.clear()
        told = [0]
        folder = tmp_path / str(batch)
        config = CampaignConfig(budget="30", batch=batch)
        store = Store.create(folder, "")
        campaign = Campaign(config, search_method(config, LOGICAL), LOGICAL, store, Watched())
        tell = campaign._method.tell

        def counted(*arguments, tell=tell, told=told):
            told[0] += 1
            return tell(*arguments)

        campaign._method.tell = counted
        campaign.run(lambda _: None)
        store.close()
        assert max(in_flight) == batch - 1


def test_what_is_counted_is_stored(tmp_path):
    folder = tmp_path / "a"

    def observe(progress):
        reader = Store.read(folder)
        assert len(reader) >= progress.executions
        assert progress.failed == sum(execution.record.failed for execution in reader.executions())
        reader.close()

    assert len(run(folder, observe=observe)) == 40


@pytest.mark.parametrize("method", METHODS)
def test_an_interrupted_campaign_goes_on_as_if_nothing_had_happened(tmp_path, method, recorded):
    folder = tmp_path / "part"
    config = CampaignConfig(budget="40", seed=3, method=method)
    for stop_after in (1, 11):
        store = Store.reopen(folder) if folder.exists() else Store.create(folder, config.to_yaml())
        campaign = Campaign(config, search_method(config, LOGICAL), LOGICAL, store, FakeExecutor())
        stop_when_told(campaign, stop_after)
        campaign.run(lambda _: None)
        assert len(store) == stop_after
        store.close()
    executed = []
    assert run(folder, FakeExecutor(executed), method=method) == recorded(method)
    assert len(executed) == 40 - 11


def stop_when_told(campaign, count):
    """Stop a campaign as soon as its method has been told of so many executions."""
    tell = campaign._method.tell

    def tell_and_stop(candidate, *rest):
        if candidate.number == count - 1:
            campaign.stop()
        return tell(candidate, *rest)

    campaign._method.tell = tell_and_stop


def test_resuming_holds_no_more_traces_than_are_in_flight(tmp_path, monkeypatch):
    run(tmp_path / "a", budget="30", batch=4)
    recalled, most = [0], [0]
    recall, observe = Store.recall, NoveltyArchive.observe

    def counting_recall(store, number):
        recalled[0] += 1
        most[0] = max(most[0], recalled[0])
        return recall(store, number)

    def counting_observe(archive, trace):
        recalled[0] -= 1
        return observe(archive, trace)

    monkeypatch.setattr(Store, "recall", counting_recall)
    monkeypatch.setattr(NoveltyArchive, "observe", counting_observe)
    run(tmp_path / "a", budget="30", batch=4)
    assert (recalled[0], most[0]) == (0, 4)


def test_what_the_store_has_lost_is_executed_again(tmp_path):
    whole = run(tmp_path / "a", budget="30")
    with closing(sqlite3.connect(tmp_path / "a" / DATABASE, isolation_level=None)) as connection:
        connection.execute("UPDATE executions SET trace = zeroblob(9) WHERE id IN (3, 29)")
        connection.execute("DELETE FROM executions WHERE id = 17")
    connection.close()
    executed = []
    assert run(tmp_path / "a", FakeExecutor(executed), budget="30") == whole
    assert len(executed) == 3


def test_earlier_running_time_is_told_apart(tmp_path):
    last = []
    run(tmp_path / "a", budget="20", observe=last.append)
    first = last[-1]
    run(tmp_path / "a", budget="30", observe=last.append)
    assert first.earlier == 0.0
    assert 0.0 < last[-1].earlier <= first.elapsed < last[-1].elapsed
    assert (first.resumed, last[-1].resumed, last[-1].executions) == (0, 20, 30)
    assert last[-1].executing <= last[-1].elapsed - last[-1].earlier


def test_an_execution_that_fails_is_no_finding(tmp_path):
    with pytest.raises(ExecutionError, match="Execution 17 could not be carried out: RuntimeError: the ADS has lost"):
        run(tmp_path / "a", FakeExecutor(fail_at=17))
    reader = Store.read(tmp_path / "a")
    assert len(reader) == 17
    assert len(run(tmp_path / "a")) == 40
    reader.close()


def test_another_program_or_configuration_is_noticed_on_resuming(tmp_path):
    run(tmp_path / "a", budget="10")
    with pytest.raises(InputError, match="execution 0 would now be a different scenario"):
        run(tmp_path / "a", seed=9)


@pytest.mark.parametrize(("novelty", "is_novel"), [(NOVELTY_THRESHOLD, False), (NOVELTY_THRESHOLD + 1e-9, True)])
def test_a_behavior_at_the_threshold_itself_is_not_novel(tmp_path, monkeypatch, novelty, is_novel):
    monkeypatch.setattr(NoveltyArchive, "observe", lambda *_: novelty)
    assert [r["novel"] for r in run(tmp_path / "a", budget="2")] == [is_novel] * 2


def test_progress_counts_each_failure_once(tmp_path):
    last = []
    records = run(tmp_path / "a", observe=last.append, budget="60", method="uniform")
    progress = last[-1]
    assert progress.executions == 60
    assert progress.failed == sum(progress.violations.values()) == sum(bool(r["violated"]) for r in records)
    assert progress.novel == sum(r["novel"] for r in records)
    assert progress.elapsed > 0


@pytest.mark.parametrize(("count", "words"), [(1, "Stopped after 1 failure, "), (3, "Stopped after 3 failures, ")])
def test_a_campaign_stops_after_so_many_failures(tmp_path, recorded, count, words):
    whole = recorded("uniform")
    last = [record["id"] for record in whole if record["violated"]][count - 1]
    config = CampaignConfig(budget="40", seed=3, method="uniform")
    with closing(Store.create(tmp_path / "run", config.to_yaml())) as store:
        campaign = Campaign(config, search_method(config, LOGICAL), LOGICAL, store, FakeExecutor(), stop_after=count)
        assert campaign.run(lambda _: None) == f"{words}as asked for"
        assert [execution.record.to_dict() for execution in store.executions()] == whole[: last + 1]


def test_a_campaign_that_goes_on_stops_only_when_all_that_it_has_came_out_again(tmp_path, recorded):
    """Seven of the eight candidates in flight at its end are new. They are executed, but not stored."""
    config, executed = CampaignConfig(budget="40", seed=3, method="uniform"), []
    run(tmp_path / "run", method="uniform", budget="30")
    with closing(Store.reopen(tmp_path / "run")) as store:
        method = search_method(config, LOGICAL)
        campaign = Campaign(config, method, LOGICAL, store, FakeExecutor(executed), stop_after=1)
        failed = sum(bool(record["violated"]) for record in recorded("uniform")[:30])
        assert campaign.run(lambda _: None) == f"Stopped after {failed} failures, as asked for"
        assert campaign.is_replayed
        assert (len(store), len(executed)) == (30, 7)


def test_other_scenarios_are_drawn_uniformly_as_in_all_versions_of_a_revision(tmp_path):
    """Their random numbers begin with the word "unif"; they are a fourth of the campaign's, and 200 at most."""
    config, executed = CampaignConfig(budget="13", seed=3, method="random", batch=1), []
    with closing(Store.create(tmp_path / "run", config.to_yaml())) as store:
        campaign = Campaign(config, search_method(config, LOGICAL), LOGICAL, store, FakeExecutor(executed))
        campaign.run(lambda _: None)
        del executed[:]
        campaign.drive_uniformly()
        generator = np.random.default_rng([int.from_bytes(b"unif"), 3])
        assert [parse_scenario(one.decode()) for one in executed] == [LOGICAL.sample(generator) for _ in range(3)]
        assert UniformRate.stored(store).n == 3


@pytest.mark.parametrize(("executions", "count"), [(799, 199), (900, 200)])
def test_of_long_campaigns_two_hundred_other_scenarios_are_executed(tmp_path, monkeypatch, executions, count):
    config, executed = CampaignConfig(budget="1000", method="random"), []
    monkeypatch.setattr(Store, "__len__", lambda _: executions)
    with closing(Store.create(tmp_path / "run", config.to_yaml())) as store:
        Campaign(config, search_method(config, LOGICAL), LOGICAL, store, FakeExecutor(executed)).drive_uniformly()
    assert len(executed) == count


def test_a_time_budget_ends(tmp_path):
    records = run(tmp_path / "a", budget="1s")
    assert len(records) > 1


def test_options_reach_the_method(tmp_path):
    with pytest.raises(InputError, match="'thet_c'"):
        run(tmp_path / "a", options={"thet_c": 0.3})


class Slow(FakeExecutor):
    """Takes a while for each execution."""

    def submit(self, evaluate, scenario):
        time.sleep(0.01)
        return super().submit(evaluate, scenario)


def test_progress_says_how_long_executions_took(tmp_path):
    seen = []
    run(tmp_path / "a", Slow(), seen.append, budget="12", method="uniform")
    assert 12 * 0.01 <= seen[-1].executing <= seen[-1].elapsed
