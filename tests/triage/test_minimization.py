"""Minimized failures: what the command finds, keeps and says."""

import json
import re
from concurrent.futures import Future
from contextlib import closing
from threading import Timer

import numpy as np
import pytest

from behavexplor.campaign.config import CampaignConfig, stored_config
from behavexplor.campaign.record import Record
from behavexplor.campaign.store import Execution, Store
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.data.scenario import Size
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError
from behavexplor.execution.executor import ADSError, Executor
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.specs import SPECS
from behavexplor.triage.blame import blame
from behavexplor.triage.counterfactual import find_cause
from behavexplor.triage.examination import STREAM
from behavexplor.triage.findings import (
    Finding,
    Minimized,
    known_minimized,
    minimized_path,
    minimized_trace_path,
    read_minimized,
)
from behavexplor.triage.minimization import MINIMIZE, ManyScenarios, signature
from tests.fakes import LOGICAL
from tests.triage.test_triage import fuzz
from tests.triage.test_triage import run as triaged  # noqa: F401 - a fixture


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("minimize") / "run"
    fuzz(folder, "tests.drivers:Timid", 25)
    assert main(["minimize", str(folder), "--workers", "0", "--quiet"]) == OK
    return folder


def records(folder):
    with closing(Store.read(folder)) as store:
        return list(store.records())


def test_the_first_failure_of_each_class_is_minimized(run):
    first = {}
    for record in records(run):
        if record.failed:
            first.setdefault(record.violation_class, record.id)
    assert sorted(first.values()) == sorted(read_minimized(run))
    assert len(first) > 1


def test_a_minimized_failure_happens_again_alone_and_in_lock_step(run):
    config = stored_config(run).unverified
    simulation = Simulation(config.env, config.ads)
    together = ManyScenarios(simulation, simulation.lock_step(4))
    for found in read_minimized(run).values():
        scenario = found.load_scenario()
        assert found.reproduced
        assert found.is_minimal
        assert {signature(one, SPECS).class_id for one in (together.run(scenario), *together.run_all([scenario]))} == {
            found.class_id
        }


def test_vehicles_and_values_that_do_not_matter_are_gone(run):
    for found in read_minimized(run).values():
        assert found.found.parts == 5
        assert found.minimal.parts <= 2
        assert found.minimal.values < found.found.values / 3
        assert found.executions <= 500
        assert len(found.load_scenario().npcs) == found.minimal.parts


def test_without_any_one_vehicle_the_failure_is_another_one(run):
    config = stored_config(run).unverified
    driven = ManyScenarios(Simulation(config.env, config.ads), None)
    logical = driven.simulation.logical
    for found in read_minimized(run).values():
        scenario = found.load_scenario()
        parts = logical.parts(scenario)
        for i in range(len(parts)):
            fewer = logical.with_parts(scenario, parts[:i] + parts[i + 1 :])
            assert signature(driven.run(fewer), SPECS).class_id != found.class_id


def test_the_trace_is_that_of_the_minimized_scenario(run):
    for found in read_minimized(run).values():
        trace = Trace.from_bytes(minimized_trace_path(run, found.id).read_bytes())
        assert trace.position.shape[1] == 1 + found.minimal.parts


def test_what_has_been_minimized_is_not_minimized_again(run, capsys):
    before = {path: path.stat().st_mtime_ns for path in (run / "minimized").iterdir()}
    assert main(["minimize", str(run), "--workers", "0", "--quiet"]) == OK
    assert before == {path: path.stat().st_mtime_ns for path in (run / "minimized").iterdir()}
    out = capsys.readouterr().out
    assert "in the median, parts 5 -> " in out
    assert all(found.class_id in out for found in read_minimized(run).values())


def test_an_execution_that_passed_cannot_be_minimized(run, capsys):
    passed = next(record.id for record in records(run) if not record.failed)
    assert main(["minimize", str(run), str(passed)]) == BAD_INPUT
    assert f"Execution {passed} of {run} has no failure" in capsys.readouterr().err


def test_numbers_beside_all_are_refused(tmp_path, capsys):
    assert main(["minimize", str(tmp_path), "3", "--all"]) == BAD_INPUT
    assert "Give either numbers of executions or --all" in capsys.readouterr().err


def test_a_flaky_failure_is_named_and_stays_as_it_is(tmp_path, capsys):
    folder = tmp_path / "run"
    fuzz(folder, "tests.triage.test_triage:Wavering", 3)
    number = next(record.id for record in records(folder) if record.failed)
    assert main(["minimize", str(folder), str(number), "--workers", "0", "--quiet"]) == OK
    assert f"Execution {number} did not fail in the same way" in capsys.readouterr().out
    found = read_minimized(folder)[number]
    assert not found.reproduced
    assert found.load_scenario() == next(record for record in records(folder) if record.id == number).load_scenario()


class Dying(Executor):
    """An executor whose process the driver ends in every call."""

    def __init__(self):
        self.calls = []

    def submit(self, function, data):
        self.calls.append(function)
        future = Future()
        if function == MINIMIZE:
            future.set_exception(ADSError("crash", "its process was ended by SIGKILL"))
        else:
            future.set_result(b"")
        return future

    def shutdown(self, *, wait=True):
        pass

    def stop(self):
        pass


class Slow(Dying):
    """An executor whose process takes a while until the driver ends it."""

    def submit(self, function, data):
        answered, future = super().submit(function, data), Future()
        Timer(0.2, lambda: future.set_exception(answered.exception())).start()
        return future if function == MINIMIZE else answered


def test_a_minimization_that_takes_long_says_what_it_does(tmp_path, monkeypatch, capsys):
    slow = Slow()
    monkeypatch.setattr("behavexplor.triage.examination.start_executor", lambda *_, **__: slow)
    monkeypatch.setattr("behavexplor.triage.minimization.PATIENCE", 0.02)
    monkeypatch.setattr("behavexplor.commands.display.LINE_SECONDS", 0.0)
    failed_run(tmp_path / "run", ["raised"])
    assert main(["minimize", str(tmp_path / "run"), "--workers", "1"]) == OK
    first, *lines = capsys.readouterr().err.splitlines()
    assert first == "1 failure to minimize, each in at most 500 executions of simpler scenarios"
    assert len(lines) > 2
    assert {line.partition(",")[0] for line in lines} == {"0 of 1 failures", "1 of 1 failures"}


def failed_run(folder, kinds):
    """A run in which the driver has failed in these ways."""
    store = Store.create(folder, CampaignConfig(ads="idm").to_yaml())
    for number, kind in enumerate(kinds):
        scenario = LOGICAL.sample(np.random.default_rng(number))
        failure = {"kind": kind, "message": ""}
        named = {"violated": ("error",), "error": failure, "class": f"error/{kind}", "scenario": scenario.to_dict()}
        record = Record.from_json(json.dumps({"id": number, "end": "error", **named}))
        store.add(Execution(record, LOGICAL.first_frame(scenario, "error").to_bytes(), 0.0))
    store.commit()
    store.close()


def test_a_driver_that_ends_or_blocks_its_process_keeps_no_other_failure_from_being_minimized(
    tmp_path, monkeypatch, capsys
):
    dying = Dying()
    monkeypatch.setattr("behavexplor.triage.examination.start_executor", lambda *_, **__: dying)
    failed_run(tmp_path / "run", ["hang", "raised", "crash"])
    assert main(["minimize", str(tmp_path / "run"), "--workers", "1", "--quiet"]) == OK
    assert " ".join(capsys.readouterr().out.split()).count("so it was not minimized") == 3
    assert dying.calls.count(MINIMIZE) == 1  # a driver that blocks would do so for hours
    found = read_minimized(tmp_path / "run")
    assert [one.class_id for one in found.values()] == ["error/hang", "error/raised", "error/crash"]
    assert not any(one.reproduced or one.is_minimal for one in found.values())


def test_what_triage_has_overtaken_or_lost_its_trace_is_minimized_again(tmp_path):
    made = {"class_id": "R1", "reproduced": True, "is_minimal": True, "found": (1, 1), "minimal": (1, 1)}
    (tmp_path / "minimized").mkdir()
    for number, fault in enumerate(["other", "other", None, "preventable"]):
        one = Minimized(id=number, fault=fault, cause=None, executions=1, violated=(), scenario={}, **made)
        one.write(tmp_path, b"trace")
    minimized_trace_path(tmp_path, 3).unlink()
    seen = {"spec": "R1", "class_id": "R1", "words": "", "same_verdict": True, "same_trace": True}
    triage = {1: Finding(id=1, fault="preventable", **seen), 2: Finding(id=2, cause="R2-1", **seen)}
    assert sorted(known_minimized(tmp_path, {})) == [0, 1, 2]
    assert sorted(known_minimized(tmp_path, triage)) == [0]
    triage = {0: Finding(id=0, fault="other", **seen), 2: Finding(id=2, **seen)}
    assert sorted(known_minimized(tmp_path, triage)) == [0, 1, 2]


@pytest.mark.parametrize("text", ["", "[]", '{"format": 9}', '{"format": 1}', '{"format": 1, "id": "x"}'])
def test_a_damaged_file_is_one_sentence(tmp_path, text):
    path = minimized_path(tmp_path, 1)
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(InputError, match=str(path)):
        read_minimized(tmp_path)


def test_the_file_is_plain_json(run):
    number = min(read_minimized(run))
    values = json.loads(minimized_path(run, number).read_text())
    assert values["scenario"]["functional"] == "intersection-straight"
    assert Size(*values["found"]).parts == 5


def test_a_report_shows_it_beside_the_failure_that_was_found(run):
    assert main(["report", str(run)]) == OK
    text = (run / "report.html").read_text()
    for found in read_minimized(run).values():
        if not found.class_id.startswith("error/"):
            assert re.search(rf'data-replays="[^"]*\b{found.id}-minimized"', text)
            assert f"of execution {found.id}: parts 5 &#8594; {found.minimal.parts}, free values" in text


@pytest.mark.slow
def test_after_triage_fault_and_cause_stay_the_same(triaged):  # noqa: F811
    assert main(["minimize", str(triaged), "0", "--workers", "0", "--quiet"]) == OK
    found = read_minimized(triaged)[0]
    assert (found.fault, found.cause) == ("preventable", "R1-1")
    config = stored_config(triaged).unverified
    simulation = Simulation(config.env, config.ads)
    scenario = found.load_scenario()
    trace = simulation.run(scenario)
    assert find_cause(simulation, scenario, trace).primary == "R1-1"
    assert blame(simulation, scenario, trace, np.random.default_rng([STREAM, config.seed, 0])).kind == "preventable"
    assert found.minimal.parts < found.found.parts
