"""The command `compare`, and its search for scenarios in which only one of two drivers fails."""

import json
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

import behavexplor
from behavexplor.campaign.config import CampaignConfig, stored_config
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, EXECUTION_FAILED, OK, UNDECIDED, main
from behavexplor.commands.compare import MarginDecision, searched, values
from behavexplor.errors import InputError
from behavexplor.judge import specs
from behavexplor.judge.outcomes import outcomes_of
from behavexplor.judge.rates import INFERIOR, NON_INFERIOR
from behavexplor.judge.specs import SPECS, judge
from behavexplor.repair.pair_campaigns import BOTH_FAIL, ONLY_FIRST, ONLY_SECOND, difference, looks, verdict_at_fault
from behavexplor.repair.pairs import AT_FAULT, Pairs, rows
from tests.judge.test_fault import BEHIND, trace

SWERVER, CRUISER = "tests.drivers:Swerver", "tests.drivers:Cruiser"


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare") / "out"
    arguments = ["compare", SWERVER, CRUISER, "--scenarios", "12", "--search", "--budget", "12", "--method", "random"]
    assert main([*arguments, "--workers", "0", "--unconfined", "--quiet", "--out", str(folder)]) == OK
    return folder


def records(folder):
    store = Store.read(folder)
    found = list(store.records())
    store.close()
    return found


def test_both_drive_the_same_scenarios(compared):
    first, second = records(compared / "first"), records(compared / "second")
    assert [one.scenario for one in first] == [one.scenario for one in second]
    assert [stored_config(compared / name).unverified.ads for name in ("first", "second")] == [SWERVER, CRUISER]


def test_the_table_counts_what_only_one_of_them_fails(compared):
    rows = {row["outcome"]: row for row in json.loads((compared / "comparison.json").read_text())}
    first, second = records(compared / "first"), records(compared / "second")
    only = [one.id for one, other in zip(first, second, strict=True) if one.failed and not other.failed]
    assert rows["any failure"]["fixed"] == only != []
    assert rows["any failure"]["n"] == 12


def test_every_difference_that_the_search_found_is_one_when_it_is_repeated(compared):
    first, second = records(compared / "search" / "first"), records(compared / "search" / "second")
    assert len(first) == len(second) > 0
    assert all(one.at_fault != other.at_fault for one, other in zip(first, second, strict=True))


def test_the_page_has_both_runs_and_the_pairs(compared):
    text = (compared / "comparison.html").read_text()
    assert "A: tests.drivers:Swerver and B: tests.drivers:Cruiser in the same scenarios" in text
    assert "any failure" in text
    assert text.count('class="run"') == 4
    assert "<h1>first" not in text
    rows = {row["outcome"]: row for row in json.loads((compared / "comparison.json").read_text())}[AT_FAULT]
    begins = [
        text.index(f'<h2 id="{name}">{name.title()} by B: {len(rows[name])}</h2>') for name in ("fixed", "broken")
    ]
    assert text.index("<h1") < begins[0] < begins[1] < text.index("How often")
    first, second = json.loads(re.search(r'id="data">(.*?)</script>', text)[1])["runs"][:2]
    for number in (*rows["fixed"], *rows["broken"]):
        assert f"<summary><b>{number}</b> <span>A: " in text
        assert str(number) in first["replays"]
        assert str(number) in second["replays"]
    assert rows["fixed"]


def test_a_driver_that_does_not_exist_is_one_sentence(tmp_path, capsys):
    assert main(["compare", "rule", "rules", "--scenarios", "1", "--workers", "0", "--out", str(tmp_path)]) == BAD_INPUT
    assert "rules" in capsys.readouterr().err


@pytest.mark.parametrize(("flag", "value"), [("--method", "nsga3"), ("--budget", "0"), ("--budget", "90s")])
def test_a_search_that_cannot_begin_is_refused_before_anybody_drives(flag, value, tmp_path, monkeypatch, capsys):
    monkeypatch.delattr("behavexplor.commands.compare._drive")
    out = tmp_path / "out"
    assert main(["compare", "rule", "idm", "--search", flag, value, "--workers", "0", "--out", str(out)]) == BAD_INPUT
    assert f"{value!r}" in capsys.readouterr().err
    assert not out.exists()


def test_a_comparison_that_was_interrupted_is_not_continued(tmp_path, capsys):
    (tmp_path / "first").mkdir()
    assert main(["compare", "rule", "idm", "--workers", "0", "--out", str(tmp_path)]) == BAD_INPUT
    assert "is not empty, and a comparison cannot be continued" in " ".join(capsys.readouterr().err.split())
    with pytest.raises(InputError, match="cannot be continued"):
        behavexplor.compare("constant", "constant", "lane-follow", scenarios=1, workers=0, out=tmp_path)


def test_a_search_that_fails_leaves_the_comparison_on_disk(tmp_path, monkeypatch, capsys):
    def fail(*_, **__):
        raise RuntimeError("a worker ended")

    written = []
    pairs = [Pairs(AT_FAULT, (), (), 0, 1)]
    for name, function in {
        "_drive": lambda *_, **__: None,
        "pair_campaigns.second_config": lambda first, *_: first,
        "pair_campaigns.compared": lambda _: pairs,
        "_write": lambda *given: written.append(given),
        "searched": fail,
    }.items():
        monkeypatch.setattr(f"behavexplor.commands.compare.{name}", function)
    arguments = ["compare", "rule", "idm", "--search", "--workers", "0", "--out", str(tmp_path)]
    assert main(arguments) == EXECUTION_FAILED
    assert "a worker ended" in capsys.readouterr().err.casefold()
    assert written == [(tmp_path, pairs, [tmp_path])]


def test_a_search_that_ends_early_says_how_many_scenarios_it_drove(tmp_path, monkeypatch, capsys):
    def differences(*given):
        given[-1](7)
        return []

    monkeypatch.setattr("behavexplor.commands.compare.pair_campaigns.differences", differences)
    config = CampaignConfig(method="random", budget="12")
    assert not searched(config, config, tmp_path, 0, sys.stdout, quiet=True)
    assert "0 of 7 scenarios in which only one driver fails; it ended before" in capsys.readouterr().out


def test_the_p_values_of_the_file_are_those_of_the_table():
    pairs = [Pairs("any failure", (), tuple(range(6)), 2, 92), Pairs("lines", (), (), 0, 100)]
    assert [f"{row['p']:.2g}" for row in values(pairs)] == [cells[-1] for cells in rows(pairs)] == ["0.062", "1"]


def verdict(degree, *violated):
    return specs.Verdict({"collision": degree, "lines": 5.0}, violated)


@pytest.mark.parametrize(
    ("first", "second", "degrees", "violated"),
    [
        (verdict(0.0, "collision"), verdict(2.0), (0.0, 2.0 + BOTH_FAIL), (ONLY_FIRST,)),
        (verdict(2.0), verdict(0.0, "collision"), (2.0 + BOTH_FAIL, 0.0), (ONLY_SECOND,)),
        (verdict(0.0, "collision"), verdict(0.0, "collision"), (BOTH_FAIL, BOTH_FAIL), ()),
        (verdict(3.0), verdict(4.0), (3.0, 4.0), ()),
    ],
)
def test_the_difference_of_verdicts(first, second, degrees, violated):
    found = difference(first, second)
    assert tuple(found.degrees.values()) == degrees
    assert found.violated == violated


def test_only_what_the_records_count_as_a_failure_at_fault_is_one():
    line = np.array([[[-10.0, -5.0], [-10.0, 5.0]]])
    struck = replace(trace(5.0, BEHIND, 9.0), illegal_lines=line)  # by a vehicle from behind, after it touched a line
    assert {"collision", "lines"} <= set(judge(struck).violated)
    assert verdict_at_fault(struck, False, SPECS).violated == ()
    assert not outcomes_of(struck).at_fault
    cut_in = trace(5.0, BEHIND, 9.0, swerve=0.5)
    assert "collision" in verdict_at_fault(cut_in, False, SPECS).violated
    assert outcomes_of(cut_in).at_fault
    assert verdict_at_fault(struck, True, SPECS).violated == ("error",)


@pytest.mark.parametrize(
    ("fixed", "broken", "margin", "found"),
    [((), (), 0.3, NON_INFERIOR), ((), range(60), 0.1, INFERIOR), (range(5), range(5, 12), 0.05, "")],
)
def test_a_margin_is_decided_from_the_pairs_in_their_order(fixed, broken, margin, found):
    pairs = Pairs(AT_FAULT, tuple(fixed), tuple(broken), 0, 60 - len(fixed) - len(broken))
    verdict = MarginDecision.of([Pairs("any failure", (), (), 0, 60), pairs], margin)
    assert verdict.found == found
    assert verdict.after < 60 or not found
    assert ("Not decided in 60" in verdict.words) == (not found)


def test_the_exit_code_and_the_files_are_the_verdict(tmp_path, capsys):
    run = ["compare", "--env", "S1", "--workers", "0", "--unconfined", "--quiet", "--scenarios", "12"]
    files = ["--json", str(tmp_path / "a.json"), "--junit", str(tmp_path / "a.xml")]
    for drivers, margin, code in (((CRUISER, CRUISER), 0.6, OK), ((CRUISER, CRUISER), 0.01, UNDECIDED)):
        out = ["--out", str(tmp_path / f"out{code}")]
        assert main([*run, *drivers, "--margin", str(margin), *out, *files]) == code
        assert json.loads((tmp_path / "a.json").read_text())["verdict"]["found"] == ("" if code else NON_INFERIOR)
        assert ("<failure" in (tmp_path / "a.xml").read_text()) == bool(code)
    assert main([*run, CRUISER, CRUISER, "--margin", "1.5"]) == BAD_INPUT
    assert "must lie between 0 and 1" in capsys.readouterr().err
    assert main([*run[:-1], "0", CRUISER, CRUISER]) == BAD_INPUT
    assert "A comparison needs at least 1 scenario, not 0" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("n", "margin", "numbers"), [(9, None, [9]), (9, 0.1, [9]), (1001, 0.1, [250, 500, 1000, 1001])]
)
def test_a_comparison_looks_ever_more_rarely_whether_it_is_decided(n, margin, numbers):
    assert list(looks(n, margin)) == numbers


def test_a_comparison_ends_when_its_margin_is_decided(tmp_path, capsys):
    drivers, folder = ["constant:IDLE", "constant:FASTER"], tmp_path / "out"
    flags = ["--env", "two-way-v0", "--workers", "0", "--quiet", "--no-confirm", "--out", str(folder)]
    file = tmp_path / "verdict.json"
    assert main(["compare", *drivers, *flags, "--margin", "0.9", "--scenarios", "700", "--json", str(file)]) == OK
    verdict = json.loads(file.read_text())["verdict"]
    assert verdict["found"] == NON_INFERIOR
    assert verdict["after"] < 250
    assert {len(records(folder / name)) for name in ("first", "second")} == {250}
    assert "Non-inferior" in capsys.readouterr().out


def test_the_standard_output_has_nothing_but_the_json_file_that_is_asked_for_there(tmp_path, capsys):
    run = ["compare", SWERVER, CRUISER, "--env", "S1", "--workers", "0", "--unconfined", "--quiet", "--scenarios", "3"]
    search = ["--search", "--budget", "12", "--method", "random"]
    assert main([*run, *search, "--json", "-", "--out", str(tmp_path / "out")]) == OK
    printed = capsys.readouterr()
    assert json.loads(printed.out)["outcomes"]
    assert "Search with random: " in printed.err
