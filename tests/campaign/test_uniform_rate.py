"""The driver's own failure rate beside a search."""

import json
from contextlib import closing

import pytest

import behavexplor
from behavexplor.campaign.campaign import Campaign, ExecutionError
from behavexplor.campaign.config import Budget
from behavexplor.campaign.store import Store
from behavexplor.campaign.uniform_rate import UniformRate, explained, own_rate
from behavexplor.commands import OK, main
from behavexplor.judge.specs import judge
from tests.drivers import Cruiser

FUZZ = ["fuzz", "--env", "S1", "--ads", "tests.drivers:Cruiser", "--workers", "0", "--unconfined"]


def test_the_rate_is_that_of_uniform_draws_whatever_the_search(tmp_path):
    rates = []
    for method in ("behavexplor", "random"):
        run = behavexplor.find_failures(Cruiser(), "S1", method=method, budget=24, out=tmp_path / method)
        rates.append(run.summary.uniform)
        assert len(run) == 24  # neither in the budget nor in the records
    assert rates[0] == rates[1]
    assert rates[0].n == 6


def test_it_grows_with_the_budget_and_is_not_drawn_twice(tmp_path, monkeypatch):
    run = behavexplor.find_failures(Cruiser(), "S1", budget=8, out=tmp_path / "run")
    assert run.summary.uniform.n == 2
    assert run.resume(Cruiser(), budget=16).summary.uniform.n == 4
    monkeypatch.setattr("behavexplor.campaign.campaign.Campaign._submit", None)
    assert run.resume(Cruiser()).summary.uniform.n == 4


def test_what_ends_the_uniform_draws_is_no_stored_execution(tmp_path, monkeypatch):
    submit, calls = Campaign._submit, []

    def breaking(campaign, number, request):
        calls.append(number)
        if len(calls) > 8:
            raise ExecutionError(f"Execution {number} could not be carried out: it broke")
        return submit(campaign, number, request)

    monkeypatch.setattr(Campaign, "_submit", breaking)
    with pytest.raises(
        ExecutionError, match="In uniformly drawn scenarios beside the search: Execution 0 could not be"
    ):
        behavexplor.find_failures(Cruiser(), "S1", budget=8, out=tmp_path / "run")
    assert len(behavexplor.open_run(tmp_path / "run")) == 8


def test_uniform_draws_are_their_own_rate(tmp_path, capsys):
    assert main([*FUZZ, "--method", "uniform", "--budget", "12", "--out", str(tmp_path / "run"), "--quiet"]) == OK
    words = " ".join(capsys.readouterr().out.split())
    run = behavexplor.open_run(tmp_path / "run")
    assert run.summary.uniform == UniformRate(12, run.summary.failed)
    assert f"so the driver's failure rate is {run.summary.failed / 12:.1%} (95%: " in words
    with closing(Store.read(run.folder)) as store:
        assert not store.note("uniform")


def test_the_summary_and_the_page_say_which_number_is_the_drivers(tmp_path, capsys):
    file = tmp_path / "found.json"
    assert main([*FUZZ, "--budget", "24", "--out", str(tmp_path / "run"), "--quiet", "--json", str(file)]) == OK
    rate = json.loads(file.read_text())["uniform"]
    said = (
        f"Of 6 other scenarios, drawn uniformly, {rate['failed']} failed, so the driver's failure rate is "
        f"{rate['rate']:.1%} (95%"
    )
    assert said in " ".join(capsys.readouterr().out.split())
    assert rate["low"] <= rate["rate"] <= rate["high"]
    assert main(["report", str(tmp_path / "run")]) == OK
    assert (
        "The search chose these scenarios, so their share of failures is not the"
        in (tmp_path / "run" / "report.html").read_text()
    )


def test_no_failure_is_not_certainty():
    rate = UniformRate(200, 0)
    assert rate.interval[0] == 0.0
    assert rate.interval[1] == pytest.approx(1 - 0.025 ** (1 / 200))
    assert own_rate("nsga2", 10, 3, Budget(executions=10), 1.0) is None
    assert "not the driver's rate" in explained("nsga2", None)
    assert own_rate("uniform", 0, 0, Budget(seconds=1.0), 1.0) is None
    assert own_rate("uniform", 9, 1, Budget(seconds=60.0), 59.0) is None
    assert own_rate("uniform", 9, 1, Budget(seconds=60.0), 60.5) == UniformRate(9, 1)


@pytest.mark.parametrize("budget", ["12", "1h"])
def test_a_run_that_ended_at_a_failure_tells_no_rate(tmp_path, capsys, budget):
    flags = ["--method", "uniform", "--budget", budget, "--stop-after", "1", "--quiet"]
    assert main([*FUZZ, *flags, "--out", str(tmp_path / "run")]) == OK
    assert "before its budget was used up, so its share of failures is not" in " ".join(capsys.readouterr().out.split())
    assert behavexplor.open_run(tmp_path / "run").summary.uniform is None


def test_a_damaged_note_is_no_rate(tmp_path):
    run = behavexplor.find_failures(Cruiser(), "S1", budget=8, out=tmp_path / "run")
    for text in (
        "{",
        "[]",
        '{"n": 0, "failed": 0}',
        '{"n": 1, "failed": 2}',
        '{"n": "x", "failed": 1}',
        '{"n": Infinity}',
    ):
        store = Store.reopen(run.folder)
        store.add_note("uniform", text)
        assert UniformRate.stored(store) is None
        store.close()


def test_the_traces_of_uniform_draws_are_judged_as_all_others(tmp_path, monkeypatch):
    judged = []
    monkeypatch.setattr(
        "behavexplor.campaign.judgment.judge", lambda trace, specs: judged.append(trace) or judge(trace, specs)
    )
    run = behavexplor.find_failures(Cruiser(), "S1", budget=16, out=tmp_path / "run")
    assert len(judged) == 16 + 4
    assert run.summary.uniform.failed == sum(bool(judge(trace).violated) for trace in judged[16:])
