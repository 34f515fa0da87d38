"""Several drivers on one page, and what the Python interface of evaluations writes."""

import json
from pathlib import Path

import pytest

import behavexplor
from behavexplor.api.evaluating import BOARD, listed
from behavexplor.api.rate_folder import CARD
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.errors import InputError
from behavexplor.judge.rates import Goal

ENTRIES = {
    "faster": {"ads": "constant:FASTER", "env": "roundabout-v0", "source": "<b>none</b>"},
    "slower": {"ads": "constant:SLOWER", "env": "roundabout-v0"},
}


@pytest.fixture(scope="module")
def ranked(tmp_path_factory):
    folder, done = tmp_path_factory.mktemp("board"), []
    page = behavexplor.board(ENTRIES, folder, scenarios=40, workers=0, observe=done.append)
    assert page == folder / BOARD
    assert done == [1, 2]
    return folder


def test_the_board_ranks_by_rate_and_divides_alpha(ranked):
    text = (ranked / BOARD).read_text()
    cards = {name: json.loads((ranked / name / f"{CARD}.json").read_text()) for name in ENTRIES}
    rates = {name: card["rates"]["failed"]["rate"] for name, card in cards.items()}
    best, worst = sorted(rates, key=rates.get)
    assert rates[best] < rates[worst]
    assert text.index(f'id="{best}"') < text.index(f'id="{worst}"')
    assert {card["alpha"] for card in cards.values()} == {0.025}
    assert "at most 2.5 %" in text
    assert "&lt;b&gt;none" in text
    assert "<b>none" not in text


def test_drivers_are_ranked_in_each_environment(tmp_path):
    here, there = ({"ads": "constant:FASTER", "env": env} for env in ("merge-v0", "roundabout-v0"))
    text = behavexplor.board({"b": there, "a": here}, tmp_path, scenarios=8, workers=0).read_text()
    assert "in each environment" in text
    assert text.index('id="a"') < text.index('id="b"')
    assert text.count('>1</td><th scope="row">') == 2


def test_a_board_of_decisions_has_no_intervals_which_hold_for_a_fixed_number_only(tmp_path):
    goal = Goal("failed", below=0.9)
    text = behavexplor.board({"a": ENTRIES["slower"]}, tmp_path, scenarios=200, workers=0, goal=goal).read_text()
    assert json.loads((tmp_path / "a" / f"{CARD}.json").read_text())["rates"]["failed"]["low"] is None
    row = text[text.index('id="a"') :].partition("</tr>")[0]
    assert " %" in row
    assert " to " not in row


def test_a_driver_has_the_same_rates_alone(ranked, tmp_path):
    found = behavexplor.evaluate("constant:FASTER", "roundabout-v0", scenarios=40, workers=0, out=tmp_path)
    card = json.loads((ranked / "faster" / f"{CARD}.json").read_text())
    assert {name: one["count"] for name, one in card["rates"].items() if name in found.counts} == found.counts
    assert card["rates"]["failed"]["count"] == found.failed > 0
    assert behavexplor.open_run(tmp_path / "failures").summary.executions == found.failed


def test_the_command_makes_the_same_page(ranked, tmp_path, capsys):
    file = tmp_path / "policies.yaml"
    file.write_text(json.dumps(ENTRIES))
    flags = ["--scenarios", "40", "--workers", "0", "--quiet"]
    assert main(["evaluate", str(file), "--out", str(tmp_path / "out"), *flags]) == OK
    assert (tmp_path / "out" / BOARD).read_bytes() == (ranked / BOARD).read_bytes()
    assert main(["evaluate", str(file), *flags]) == BAD_INPUT
    assert "give --out FOLDER" in capsys.readouterr().err
    assert main(["evaluate", str(file), "--outcome", "colision", "--out", str(tmp_path / "out"), *flags]) == BAD_INPUT
    assert "did you mean 'collision'?" in capsys.readouterr().err


def test_a_driver_that_fails_is_ranked_with_its_errors(tmp_path):
    file = tmp_path / "policies.yaml"
    file.write_text("lost: {ads: 'tests.drivers:Lost', env: lane-follow}\ncareful: {ads: idm, env: lane-follow}\n")
    flags = ["--scenarios", "3", "--workers", "1", "--quiet", "--out", str(tmp_path / "out"), "--outcome", "error"]
    assert main(["evaluate", str(file), *flags]) == OK
    rates = [
        json.loads((tmp_path / "out" / name / f"{CARD}.json").read_text())["rates"] for name in ("lost", "careful")
    ]
    assert [rate.get("error", {"count": 0})["count"] for rate in rates] == [3, 0]
    text = (tmp_path / "out" / BOARD).read_text()
    assert text.index('id="careful"') < text.index('id="lost"')


def test_the_entry_whose_driver_cannot_be_used_is_named(tmp_path):
    entries = {"good": {"ads": "idm", "env": "lane-follow"}, "bad": {"ads": "idm", "env": "lane-follow", "traffc": 1}}
    with pytest.raises(InputError, match=r"^bad: .*traffc"):
        behavexplor.board(entries, tmp_path, scenarios=1, workers=0)


def test_a_folder_of_policies_is_listed_by_names():
    found = listed("docs/data/policies")
    assert found["roundabout"] == {"ads": "docs/data/policies/roundabout.zip"}
    assert "highway-wide" not in found


def test_the_list_in_docs_has_every_policy():
    listed_drivers = {entry["ads"] for entry in listed("docs/data/policies/board.yaml").values()}
    assert {entry["ads"] for entry in listed("docs/data/policies").values()} < listed_drivers
    shipped = {f"learned:{file.stem}" for file in Path("behavexplor/ads/learned/policies").glob("*.npz")}
    assert {*shipped, "rule", "idm", "careful"} < listed_drivers


@pytest.mark.parametrize("given", [{}, {"a": {"env": "x"}}, {"a": "idm"}])
def test_what_names_no_drivers_is_refused(given):
    with pytest.raises(InputError, match=r"has no policy|expected drivers by name"):
        listed(given)


@pytest.mark.parametrize("name", ["../a", "a\x1b[2J", "", "a b", ".a", 7])
def test_a_name_that_is_none_of_a_folder_is_said(name):
    with pytest.raises(InputError, match=r"the name .* becomes that of a folder, and must consist of letters") as said:
        listed({"b": {"ads": "idm"}, name: {"ads": "idm"}})
    assert str(said.value).isprintable()


def test_trust_counts_only_if_the_user_gives_it(tmp_path):
    entry = {"a": {"ads": "idm", "env": "S1", "unconfined": True}}
    with pytest.raises(InputError, match="counts only on the command line"):
        behavexplor.board(entry, tmp_path, scenarios=1)


@pytest.mark.parametrize("scenarios", [0, -5])
def test_an_evaluation_of_no_scenarios_is_refused(scenarios):
    with pytest.raises(InputError, match="scenarios must be at least 1"):
        behavexplor.evaluate("constant:FASTER", "highway-fast-v0", scenarios=scenarios)


@pytest.mark.parametrize("key", ["scenarios", "goal", "observe", "alpha", "out"])
def test_an_entry_sets_nothing_that_all_drivers_share(key):
    with pytest.raises(InputError, match=f"a has the key '{key}'"):
        listed({"a": {"ads": "careful", "env": "highway-fast-v0", key: 3}})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"alpha": 2.0}, "alpha must lie between 0 and 1, got 2.0"),
        ({"goal": 0.1}, "goal must be a behavexplor.Goal, got 0.1"),
        ({"scenarios": 0}, "scenarios must be at least 1, got 0"),
        ({"env": ""}, "name of the environment is empty"),
    ],
)
def test_what_an_evaluation_cannot_use_is_refused_before_anybody_drives(settings, message, monkeypatch):
    monkeypatch.delattr("behavexplor.api.evaluating.start_judge")
    with pytest.raises(InputError, match=message):
        behavexplor.evaluate("constant", **{"env": "lane-follow", "workers": 0, **settings})


def test_an_empty_name_is_no_environment(capsys):
    assert main(["fuzz", "--env", "", "--ads", "constant"]) == BAD_INPUT
    assert "name of the environment is empty" in capsys.readouterr().err
    with pytest.raises(InputError, match="name of the environment is empty"):
        behavexplor.find_failures("constant", "", budget=1)
