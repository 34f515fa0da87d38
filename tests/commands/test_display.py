"""What a campaign shows on a terminal and elsewhere."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

from behavexplor.campaign.config import Budget
from behavexplor.campaign.confirmation import FOLDER, Confirmation, keep, read_confirmations
from behavexplor.campaign.progress import ClassSummary, Progress
from behavexplor.commands.display import Display, summary
from behavexplor.commands.wording import clock
from tests.campaign.test_store import execution, filled, store  # noqa: F401 - a fixture

PROGRESS = Progress(
    executions=50,
    failed=6,
    violations={"collision": 4, "lines": 0, "destination": 2},
    classes={
        "R1/going-straight/leading/car-sized": ClassSummary("R1/going-straight/leading/car-sized", 4, 3, 2),
        "R3/going-straight/passed": ClassSummary("R3/going-straight/passed", 2, 7, 1),
    },
    novel=10,
    elapsed=20.0,
    executing=15.0,
    method={"corpus": 12, "mean_energy": 0.75},
    last={"novel": 39, "collision": 48},
)


class Terminal(io.StringIO):
    def isatty(self):
        return True


def shown(stream, budget, progress=PROGRESS, quiet=False):
    with Display(stream, budget, quiet=quiet) as display:
        display.show(progress)
        if display._last_line is not None:
            display._last_line -= 60
        display.show(progress)
    return stream.getvalue()


def test_a_plain_line():
    line = shown(io.StringIO(), Budget(executions=100))
    assert "50 of 100 executions, 6 failed in 2 classes; 2.5/s, 0:20 left" in line
    assert len(line) <= 101


def test_a_time_budget_is_left_over_in_time():
    assert "50 executions, 6 failed" in shown(io.StringIO(), Budget(seconds=80))
    assert "1:00 left" in shown(io.StringIO(), Budget(seconds=80))


def test_lines_do_not_come_too_often():
    stream = io.StringIO()
    display = Display(stream, Budget(executions=100), quiet=False)
    for _ in range(10):
        display.show(PROGRESS)
    assert stream.getvalue() == ""


def test_quiet_shows_nothing():
    assert shown(io.StringIO(), Budget(executions=100), quiet=True) == ""
    assert shown(Terminal(), Budget(executions=100), quiet=True) == ""


def test_the_screen_of_a_terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "120")
    screen = shown(Terminal(), Budget(executions=100))
    for part in ("50 of 100 executions", "2.5 per second", "75% of the time", "12.0%", "0.75", "kept scenarios"):
        assert part in screen
    assert "mean weight in selection" in screen
    assert "last 10 ago" in screen


def test_the_share_of_executing_is_that_of_the_time_since_resuming(monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "120")
    resumed = replace(PROGRESS, elapsed=1020.0, earlier=1000.0)
    assert "75% of the time" in shown(Terminal(), Budget(executions=100), resumed)


@pytest.mark.parametrize(("seconds", "text"), [(0, "0:00"), (59.6, "1:00"), (61, "1:01"), (3661, "1:01:01")])
def test_clock(seconds, text):
    assert clock(seconds) == text


def summarized(store, *executions, method="nsga2"):  # noqa: F811 - the fixture
    """The summary of a campaign of 50 executions, of which these failed."""
    for one in executions:
        store.add(one)
    store.commit()
    progress = Progress(elapsed=20.0, violations={"collision": 0, "lines": 0, "destination": 0})
    for record in store.records():
        progress = progress.after(record, resumed=False)
    return summary(replace(progress, executions=50), store, "behavexplor", method, Budget(executions=50))


def test_the_summary_lists_the_first_failures_of_each_kind(store):  # noqa: F811 - the fixture
    filled(store)
    collisions = [execution(number, ["collision", "destination"], "R1/kind") for number in range(3, 7)]
    text = summarized(store, *collisions, execution(7, ["destination"], "R3/kind"))
    assert "collision        4   executions 3, 4, 5, ..." in text
    assert "destination      1   executions 7\n" in text
    assert "lines " not in text
    assert f"\nbehavexplor replay {store.folder} 3\n" in text  # on a line of its own, to be copied


def test_one_class_is_no_classes(store):  # noqa: F811 - the fixture
    text = summarized(store, execution(0, ["collision"], "R1/kind"))
    assert "1 failed (2.0%) in 1 class. The" in " ".join(text.split())
    assert "A guided search cannot tell how many classes it has not found; another seed\nfinds more.\n" in text


def test_the_summary_lists_the_most_frequent_classes(store):  # noqa: F811 - the fixture
    kinds = [f"R1/kind-{min(number // 2, 10):02}" for number in range(30)]
    text = summarized(store, *(execution(i, ["collision"], kind) for i, kind in enumerate(kinds)), method="uniform")
    assert all(len(line) <= 80 for line in text.splitlines() if str(store.folder) not in line)
    assert "30 failed (60.0%) in 11 classes. The" in " ".join(text.split())
    assert "The 8 most frequent classes:\n     10  R1/kind-10\n         R1/kind-10, first 20\n" in text
    assert "kind-07" not in text
    assert (
        "The next execution shows a new class with a probability of at most 10.6%, and a\n"
        "second campaign of this size, with another seed, at most 4 new classes (95 %).\n" in text
    )


def test_what_is_not_confirmed_is_said_to_be_an_error_of_this_package(store):  # noqa: F811 - the fixture
    keep(store.folder, 0, Confirmation("disagrees", "the vehicles are up to 3 m\x1b apart"))
    keep(store.folder, 1, Confirmation("confirmed"))
    (store.folder / FOLDER / "000002.json").write_text("[" * 100_000)
    (store.folder / FOLDER / "000003.json").write_text('{"state": "sure"}')
    assert list(read_confirmations(store.folder)) == [0, 1]
    failed = [execution(number, ["collision"], "R1/a") for number in range(3)]
    text = " ".join(summarized(store, *failed).split())
    assert (
        "highway-env does not confirm the failure in execution 0, which is an error of behavexplor and not of the "
        "driver: the vehicles are up to 3 m\\x1b apart" in text
    )
    assert "in execution 1" not in text


def test_the_summary_of_a_campaign_without_failures(store):  # noqa: F811 - the fixture
    text = summary(Progress(executions=3, elapsed=1.0), filled(store), "behavexplor", "uniform", Budget(executions=3))
    assert "None failed." in text
    assert "replay" not in text


def test_markup_in_names_is_not_obeyed():
    stream = io.StringIO()
    Display(stream, Budget(executions=1), quiet=False).say("Fuzzing [red]x[/red]:y")
    assert stream.getvalue() == "Fuzzing [red]x[/red]:y\n"


def test_the_terminal_is_recognized():
    assert Console(file=Terminal(), force_terminal=None).is_terminal
