"""Judging in other processes gives the same records as judging in the campaign's own."""

import json
import re
import subprocess
import sys
import time
from concurrent.futures import Future
from contextlib import closing
from dataclasses import replace
from itertools import repeat
from types import SimpleNamespace

import numpy as np
import pytest

from behavexplor.behavior.features import state_matrix
from behavexplor.campaign import judges as judges_module
from behavexplor.campaign import opening
from behavexplor.campaign.campaign import ExecutionError
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.judges import Judges, judged
from behavexplor.campaign.judgment import ads_failure, confirmation, judgment, repeat_execution
from behavexplor.campaign.opening import opened
from behavexplor.campaign.record import Record
from behavexplor.campaign.store import Execution, Store
from behavexplor.data.trace import Trace
from behavexplor.execution.executor import ADSError
from behavexplor.execution.messages import packed, unpacked
from behavexplor.execution.start import start_executor
from behavexplor.judge.closest_approach import Nearness
from behavexplor.judge.specs import SPECS, judge
from tests.fakes import LOGICAL, simulate

READY = Judges.ready
RNG = np.random.default_rng(0)
TRACES = [simulate(LOGICAL.sample(RNG)).to_bytes() for _ in range(20)]


def done(data):
    future = Future()
    future.set_result(data)
    return future


@pytest.fixture(scope="module")
def judges():
    made = ready(Judges(1))
    yield made
    made.shutdown()


def ready(judges):
    """Wait for the processes."""
    end = time.monotonic() + 120
    while not READY(judges) and time.monotonic() < end:
        time.sleep(0.02)
    return judges


def test_a_judge_says_what_the_campaign_would_say(judges):
    late = [Future() for _ in TRACES]
    futures = [judges.follow(future) for future in late]
    for future, data in zip(late, TRACES, strict=True):  # they arrive while the first ones are being judged
        future.set_result(data)
    for future, data in zip(futures, TRACES, strict=True):
        found, own = future.result(60), judgment(data, None, SPECS)
        assert (found.result, found.data, found.members) == (own.result, data, own.members)
        assert state_matrix(found.trace).tobytes() == state_matrix(own.trace).tobytes()
        assert "position" not in vars(found.trace)  # nothing has been read until now
        assert found.trace.to_bytes() == data
    assert any(future.result().result.failed for future in futures)


def test_a_judge_computes_how_near_a_failure_was_if_the_method_uses_it():
    made = ready(Judges(1, nearness=True))
    futures, found = [made.follow(done(data)) for data in TRACES], set()
    for future, data in zip(futures, TRACES, strict=True):
        judged_one, trace = future.result(60), Trace.from_bytes(data)
        nearness = Nearness.of(judged_one.trace, judged_one.result.verdict)
        assert nearness == Nearness.of(trace, judge(trace, SPECS))
        assert "position" not in vars(judged_one.trace)  # nothing has been read
        found.add(nearness)
    made.shutdown()
    assert len(found) > 5


def test_what_is_no_trace_is_the_drivers_failure(judges):
    whole, other, failing = judges.follow(done(TRACES[0])), judges.follow(done(b"no trace")), Future()
    failed = judges.follow(failing)
    failing.set_exception(ADSError("raised", "no gap"))
    canceled, never = Future(), None
    never = judges.follow(canceled)
    canceled.cancel()
    assert whole.result(60).result.end
    for future, words in ((other, "sent what is no trace"), (failed, "no gap")):
        with pytest.raises(ADSError, match=words):
            future.result(60)
    assert never.exception(60) is not None
    with pytest.raises(ADSError, match="sent what is no trace"):
        judgment(b"no trace", None, SPECS)


def test_what_arrives_after_the_end_is_left_alone(caplog):
    made, late = ready(Judges(1)), Future()
    judging = made.follow(late)
    made.shutdown()
    late.set_result(TRACES[0])
    assert not judging.done()
    assert not caplog.records


def test_what_waits_behind_a_group_that_fails_is_judged_nevertheless():
    made, answers = Judges(1), []

    def submit(*_):
        answers.append(Future())
        return answers[-1]

    made._pool = SimpleNamespace(submit=submit)
    first, second = made.follow(done(TRACES[0])), made.follow(done(TRACES[1]))
    answers[0].set_exception(RuntimeError("a worker ended"))
    assert first.exception(0).args == ("a worker ended",)
    answers[1].set_result(packed([judged(TRACES[1])]))
    assert second.result(0).data == TRACES[1]


@pytest.mark.parametrize(("workers", "processes"), [(1, 1), (4, 1), (5, 2)])
def test_each_process_has_one_group_at_a_time_with_all_that_has_come_since(workers, processes):
    """There is a process for each four workers."""
    made, groups, answers = Judges(workers), [], []

    def submit(_, data):
        groups.append(unpacked(data)[::2])
        answers.append(Future())
        return answers[-1]

    made._pool = SimpleNamespace(submit=submit)
    futures = [made.follow(done(data)) for data in TRACES[:6]]
    assert groups == [[data] for data in TRACES[:processes]]
    for number in range(3):
        answers[number].set_result(packed([judged(data) for data in groups[number]]))
        futures.append(made.follow(done(TRACES[6 + number])))
        assert sum(not answer.done() for answer in answers) == processes
    assert groups[processes] == TRACES[processes:6]
    assert [data for group in groups for data in group] == TRACES[: sum(map(len, groups))]


@pytest.mark.parametrize(
    ("workers", "logical", "begun", "will_draw"),
    [
        (1, LOGICAL, None, True),  # they are still loading, and will draw
        (1, LOGICAL, b"", True),
        (1, LOGICAL, RuntimeError("they cannot begin"), False),
        (0, LOGICAL, None, False),
        (1, None, b"", False),
    ],
)
def test_judges_that_know_where_they_are_draw_scenarios_from_the_beginning(
    monkeypatch, workers, logical, begun, will_draw
):
    first = Future()
    if begun is not None:
        (first.set_exception if isinstance(begun, Exception) else first.set_result)(begun)
    monkeypatch.setattr(judges_module, "WorkerPool", lambda *_: SimpleNamespace(submit=lambda *_: first))
    assert Judges(workers, logical).will_draw() is will_draw


def lasts(trace):
    """A requirement of a user."""
    return trace.duration


@pytest.mark.parametrize(
    ("budget", "workers", "settings", "expected"),
    [
        ("1499", 3, {}, None),
        ("1500", 3, {}, (3, False)),
        ("1h", 3, {}, (3, False)),
        ("1500", 3, {"method": "niching"}, (3, True)),
        ("1500", 0, {}, None),
        ("1500", 3, {"specs": (f"{__name__}:lasts",)}, None),
    ],
)
def test_long_campaigns_with_workers_and_built_in_specs_have_judges(
    tmp_path, monkeypatch, budget, workers, settings, expected
):
    made = []

    def noted(count, logical, *, nearness):
        made.append((count, nearness))
        return SimpleNamespace(shutdown=lambda: None)

    monkeypatch.setattr(opening, "Judges", noted)
    monkeypatch.setattr(opening, "start_executor", lambda target, _, *given: start_executor(target, 0, *given))
    config = CampaignConfig(env="lane-follow", ads="constant", budget=budget, **settings)
    with opened(config, tmp_path / "run", workers, resume=False):
        assert made == ([] if expected is None else [expected])


def test_messages_are_taken_apart():
    parts = [b"", b"a" * 300, b"\n"]
    assert unpacked(packed(parts)) == parts
    assert unpacked(b"") == []
    for other in (b"\1", packed(parts)[:-1], b"\xff" * 20):
        with pytest.raises(ValueError, match="too short"):
            unpacked(other)
    assert judged(b"").startswith(b'"error": "its process sent what is no trace: ')


def test_a_packed_trace_is_a_trace():
    whole = simulate(LOGICAL.sample(np.random.default_rng(1)))
    for change in (
        lambda trace: trace.until(5, "timeout"),
        lambda trace: trace.with_decisions({"bits": np.zeros(len(whole.actions))}),
        lambda trace: trace,
    ):
        trace = Trace.of_packed(whole.to_bytes())
        assert isinstance(trace, Trace)
        assert change(trace).to_bytes() == change(whole).to_bytes()
        assert (trace.partner, trace.duration, trace.end) == (whole.partner, whole.duration, whole.end)
    for trace in (whole, Trace.of_packed(whole.to_bytes())):
        assert not hasattr(trace, "no_such_field")
        assert not hasattr(trace, "__array__")


CONFIG = CampaignConfig(env="lane-change", ads="constant:1", budget="40", seed=2)


def run(folder, workers, **config):
    with opened(CampaignConfig(**{**vars(CONFIG), **config}), folder, workers, resume=folder.exists()) as ready:
        ready.campaign.run(lambda _: None)
    with closing(Store.read(folder)) as store:
        return [(one.record.to_dict(), one.trace) for one in store.executions()]


@pytest.mark.parametrize(
    ("method", "target"),
    [
        ("behavexplor", {}),
        ("avfuzzer", {}),
        ("uniform", {}),
        ("uniform", {"env": "highway-fast-v0", "ads": "constant:FASTER"}),
    ],
)
def test_records_do_not_depend_on_who_judges(tmp_path, monkeypatch, method, target):
    whole = run(tmp_path / "here", 0, method=method, **target)
    followed, follow = [], Judges.follow
    monkeypatch.setattr(opening, "LEAST_EXECUTIONS", 1)
    monkeypatch.setattr(Judges, "ready", ready)
    monkeypatch.setattr(Judges, "follow", lambda self, *given: followed.append(given) or follow(self, *given))
    assert run(tmp_path / "there", 2, method=method, budget="20", **target) == whole[:20]
    assert len(followed) == 20
    assert run(tmp_path / "there", 2, method=method, **target) == whole
    assert len(followed) == 40
    drawn = [b"[2, %d]" % number for number in range(40)]  # by the workers, and again by the judges
    assert [request for _, request in followed] == (drawn if method == "uniform" else [b""] * 40)


def test_the_drivers_failure_is_recorded_with_its_scenario_though_a_worker_has_drawn_it(tmp_path, monkeypatch):
    config = {"method": "uniform", "ads": "tests.drivers:Faulty", "budget": "3"}
    alone = run(tmp_path / "alone", 1, **config)
    monkeypatch.setattr(opening, "LEAST_EXECUTIONS", 1)
    assert run(tmp_path / "judged", 1, **config) == alone
    assert {record["class"] for record, _ in alone} == {"error/raised"}


def test_a_judge_that_ends_is_not_the_drivers_failure(tmp_path, monkeypatch):
    def lose(self, driven, drawn):
        judging = Future()
        driven.add_done_callback(lambda _: judging.set_exception(RuntimeError("a worker ended: its process is gone")))
        return judging

    monkeypatch.setattr(opening, "LEAST_EXECUTIONS", 1)
    monkeypatch.setattr(Judges, "ready", lambda _: True)
    monkeypatch.setattr(Judges, "follow", lose)
    with pytest.raises(ExecutionError, match="Execution 0 could not be carried out: RuntimeError: a worker ended"):
        run(tmp_path / "run", 1)
    with closing(Store.read(tmp_path / "run")) as store:
        assert len(store) == 0


@pytest.mark.slow
def test_a_long_campaign_that_is_killed_ends_as_any_other(tmp_path):
    command = [sys.executable, "-m", "behavexplor", "fuzz", "--quiet", "--workers"]
    new = ["--env", "lane-change", "--ads", "constant", "--method", "uniform", "--budget", "1600", "--out"]
    subprocess.run([*command, "1", *new, str(tmp_path / "whole")], check=True, capture_output=True)
    arguments, rng, lives = [*new, str(tmp_path / "killed")], np.random.default_rng(0), 0
    while lives < 5:
        life = subprocess.Popen([*command, "2", *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while not (tmp_path / "killed" / "campaign.db").exists():
            time.sleep(0.01)
        time.sleep(rng.uniform(2.0, 6.0))
        life.kill()
        life.wait()
        arguments, lives = ["--resume", str(tmp_path / "killed")], lives + 1
    subprocess.run([*command, "2", *arguments], check=True, capture_output=True)
    with closing(Store.read(tmp_path / "whole")) as one, closing(Store.read(tmp_path / "killed")) as other:
        for first, second in zip(one.executions(), other.executions(), strict=True):
            assert (first.record, first.trace) == (second.record, second.trace)
        assert len(one) == 1600


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, ""),
        (
            {"violated": (), "violation_class": None, "fault": None},
            r"violated \[\] instead of \['collision'.*, class None",
        ),
        ({"fault": "?"}, "fault '\\?' instead of "),
        ({"end": "?"}, "end '\\?' instead of "),
        ({"duration": 1.0}, "duration 1.0 instead of "),
        ({"error": {"kind": "raised", "message": ""}, "violated": ("error",)}, r"violated \['error'\] instead of"),
        ({"violated": ("collision", "my_spec"), "violation_class": "mine"}, ""),  # whose code is not run
        ({"violated": ("my_spec",), "violation_class": "mine"}, r"violated \[\] instead of \['collision'"),
    ],
)
def test_a_record_is_compared_with_the_judgment_of_its_trace(change, words):
    scenarios = map(LOGICAL.sample, repeat(np.random.default_rng(1), 1000))
    scenario = next(one for one in scenarios if judge(simulate(one)).violated == ("collision",))
    data = simulate(scenario).to_bytes()
    written = json.loads(f"{{{','.join(judgment(data, None, SPECS).members)}}}")
    record = Record.from_json(json.dumps({"id": 0, "scenario": scenario.to_dict(), **written}))
    again = SimpleNamespace(submit=lambda *_: done(data))
    found = repeat_execution(again, Execution(replace(record, **change), data, 0.0))
    assert found.reproduced == (not words)
    assert not words or re.search(f"The record is NOT that of the execution: .* says {words}", found.words)


def test_an_answer_that_is_no_trace_is_the_failure_that_a_record_has_of_it():
    data, scenario = TRACES[0], LOGICAL.sample(np.random.default_rng(1))
    with pytest.raises(ADSError) as failed:
        judgment(b"no trace", None, SPECS)
    written = json.loads(f"{{{','.join(judgment(data, ads_failure(failed.value), SPECS).members)}}}")
    execution = Execution(Record.from_json(json.dumps({"id": 0, "scenario": scenario.to_dict(), **written})), data, 0.0)
    again = SimpleNamespace(submit=lambda *_: done(b"no trace"))
    assert repeat_execution(again, execution).reproduced
    assert confirmation(again, execution).state == "confirmed"
