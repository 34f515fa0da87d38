"""Where the time of a campaign goes: it is counted, stored with the executions, and read from damaged files."""

import math
import sqlite3
import time
from contextlib import closing, suppress

import pytest

from behavexplor.campaign.config import stored_config
from behavexplor.campaign.folder_format import DATABASE
from behavexplor.campaign.opening import opened
from behavexplor.campaign.progress import STAGES, Stage, StageClock, executing_and_analysing, known_stages
from behavexplor.campaign.store import Store
from behavexplor.commands import OK, main
from behavexplor.report.charts import stage_parts


@pytest.fixture
def begun():
    """When the test began, by the clock that the stages are measured with."""
    return time.monotonic()


@pytest.fixture
def run(tmp_path, begun):
    arguments = ["--ads", "tests.drivers:cruiser", "--method", "uniform", "--budget", "4", "--unconfined"]
    assert main(["fuzz", *arguments, "--workers", "0", "--quiet", "--out", str(tmp_path / "run")]) == OK
    return tmp_path / "run"


def stages_of(run):
    store = Store.read(run)
    try:
        return store.stages, store.elapsed
    finally:
        store.close()


def test_the_clock_counts_each_stage_and_continues_after_an_interruption():
    clock = StageClock({Stage.JUDGING: 10.0})
    with suppress(KeyError), clock.during(Stage.JUDGING):
        time.sleep(0.02)
        raise KeyError
    assert 0.02 <= clock.seconds[Stage.JUDGING] < 5
    assert clock.total[Stage.JUDGING] == 10 + clock.seconds[Stage.JUDGING]
    assert sum(clock.seconds.values()) == clock.seconds[Stage.JUDGING]


def test_a_run_keeps_the_time_in_each_stage_and_a_resumed_one_adds_to_it(begun, run):
    first, elapsed = stages_of(run)
    assert sum(first.values()) < time.monotonic() - begun
    assert list(first) == list(STAGES)
    assert first[Stage.STARTING] > 0 < first[Stage.EXECUTING]
    assert first[Stage.WAITING] == 0
    assert sum(first.values()) - first[Stage.STARTING] < elapsed + 1
    assert main(["fuzz", "--resume", str(run), "--budget", "6", "--workers", "0", "--quiet"]) == OK
    second, _ = stages_of(run)
    assert all(second[name] >= first[name] for name in STAGES)
    assert second[Stage.EXECUTING] > first[Stage.EXECUTING]


def test_what_is_stored_counts_for_the_start_when_a_run_is_resumed(run):
    before, _ = stages_of(run)
    with opened(stored_config(run).unverified, run, 0, resume=True) as ready:
        clock = ready.campaign.clock
        begun = clock.seconds[Stage.STARTING]
        ready.campaign.run(lambda _: None)
    assert {name for name, seconds in clock.seconds.items() if seconds} == {Stage.STARTING, Stage.STORING}
    assert clock.seconds[Stage.STARTING] > begun
    after, _ = stages_of(run)
    assert {name for name in STAGES if after[name] != before[name]} == {Stage.STARTING}


def test_executing_and_analysing_are_all_stages_but_the_start():
    stages = {name: float(2**i) for i, name in enumerate(STAGES)}
    executing, analysing = executing_and_analysing(stages)
    assert executing == stages[Stage.EXECUTING] + stages[Stage.WAITING]
    assert executing + analysing + stages[Stage.STARTING] == sum(stages.values())
    assert executing_and_analysing({"waiting": 2.0, "mining": 3.0}) == (2.0, 3.0)
    assert executing_and_analysing({"executing": 2.0, "starting": 3.0}) == (2.0, 0.0)
    assert all(map(math.isnan, executing_and_analysing({})))


@pytest.mark.parametrize("note", ["", "[]", '{"judging": "1"}', '{"judging": NaN, "more": 1}', "[" * 100_000, "1e999"])
def test_a_run_without_a_readable_note_has_no_stages(run, note):
    with closing(sqlite3.connect(run / DATABASE, isolation_level=None)) as connection:
        connection.execute("UPDATE meta SET value = ? WHERE key = 'stages'", (note,))
    connection.close()
    assert stages_of(run)[0] == {}
    assert stage_parts({}) == ()


def test_only_known_stages_with_times_are_read():
    values = {"storing": 2, "asking": 0.5, "judging": -1, "mining": True, "waiting": 10**400, "<b>": 1}
    assert known_stages(values) == {"asking": 0.5, "storing": 2.0}


def test_the_parts_of_the_bar_fill_it_in_order():
    parts = stage_parts({"asking": 1.0, "executing": 5.0, "waiting": 0.0, "storing": 2.0})
    assert [(part.name, part.begin, part.share) for part in parts] == [
        ("asking", 0, 12.5),
        ("executing", 12.5, 62.5),
        ("storing", 75, 25),
    ]
