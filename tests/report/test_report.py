"""The command: one page, made from run folders alone."""

import json
import re
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.database_file import connect
from behavexplor.campaign.database_rows import Row, insert
from behavexplor.campaign.folder_format import CONFIG
from behavexplor.campaign.store import DATABASE, Execution, Store
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.data.trace import Trace
from behavexplor.report import run_page
from behavexplor.report.reading import read_run
from behavexplor.report.run_page import PAGE, page
from behavexplor.triage.findings import TRIAGE, Triage
from tests.report.conftest import EVIL, changed, copied


class Outline(HTMLParser):
    """What a browser would make of a page: its tags with their attributes, and its text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.words = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.words.append(data)

    def count(self, tag):
        return sum(name == tag for name, _ in self.tags)


def data_of(text):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)[1])


def plain(text):
    """The text of a page, without what is no text."""
    without = re.sub(r"<(script|style|svg)\b.*?</\1>", "", text, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]*>", " ", without).split())


@pytest.fixture(scope="module")
def text(run):
    return page([read_run(run)], 100)


def test_the_report_lies_in_the_run_folder_and_is_the_same_again(run, tmp_path, capsys):
    folder = shutil.copytree(run, tmp_path / "run")
    assert main(["report", str(folder)]) == OK
    assert capsys.readouterr().out == f"Report: {folder / PAGE}\n"
    first = (folder / PAGE).read_bytes()
    assert main(["report", str(folder)]) == OK
    assert (folder / PAGE).read_bytes() == first
    moved = shutil.copytree(folder, tmp_path / "elsewhere" / "run")
    (moved / PAGE).unlink()
    assert main(["report", str(moved)]) == OK
    assert (moved / PAGE).read_bytes() == first


def test_the_page_says_what_was_tested_and_what_was_found(run, text):
    read, words = read_run(run), plain(text)
    assert "behavexplor tested tests.drivers:cruiser in 24 intersection-straight scenarios" in words
    assert f"{len(read.findings)} executions failed, in {len(read.classes)} classes" in words
    for class_id, findings in read.classes.items():
        assert class_id in words
        assert findings[0].words in words
    assert "to find out whose fault they were" in words
    for digest in read.digests.values():
        assert digest in words
    assert "seed 5" in words


def test_there_is_a_card_for_each_class_with_its_replay(run, text):
    classes = read_run(run).classes
    cards = [attributes for tag, attributes in Outline(text).tags if tag == "article"]
    assert [card["data-class"] for card in cards][: len(classes)] == list(classes)
    replays = data_of(text)["runs"][0]["replays"]
    assert {str(findings[0].id) for findings in classes.values()} <= replays.keys()


def test_curves_have_the_records_figures(run, text):
    words = plain(text)
    read = read_run(run)
    for title in ("Failures", "Classes of violations", "New behaviors", "Novelty", "Energy of the parent"):
        assert title in words
    last = {title: re.search(rf"{title} Table .*? {len(read.entries)} (\d+) ", words)[1] for title in ("Failures",)}
    assert int(last["Failures"]) == len(read.findings)


def test_the_page_asks_for_nothing(text):
    """No address but its own anchors; the policy would forbid any other."""
    for tag, attributes in Outline(text).tags:
        for name in ("src", "href", "action", "data", "style", "onclick", "onload"):
            value = attributes.get(name)
            assert value is None or value.startswith("#") or (tag, value) == ("link", "data:,")
    policy = next(attributes["content"] for tag, attributes in Outline(text).tags if "http-equiv" in attributes)
    assert policy.startswith("default-src 'none'; ")
    assert "unsafe" not in policy
    assert "url(" not in text
    assert "@import" not in text


def test_the_page_holds_no_path_of_this_machine(run, text):
    assert str(run.parent) not in text
    assert str(Path.home()) not in text


def test_the_page_names_a_policy_without_its_folder(run, tmp_path):
    copy = shutil.copytree(run, tmp_path / "copy")
    config = (copy / CONFIG).read_text()
    (copy / CONFIG).write_text(re.sub(r"^ads: .*$", "ads: /home/somebody/secret/model.zip", config, flags=re.MULTILINE))
    text = page([read_run(copy)], 0)
    assert "model.zip" in text
    assert "secret" not in text


def test_names_are_text_wherever_they_come_from(run, evil_run):
    honest, broken = (Outline(page([read_run(folder)], 100)) for folder in (run, evil_run))
    assert broken.count("script") == honest.count("script") == 2
    assert broken.count("img") == 0
    assert EVIL in "".join(broken.words)
    text = page([read_run(evil_run)], 100)
    assert "run &lt;b&gt;&amp;amp;" in text
    types = [name for replay in data_of(text)["runs"][0]["replays"].values() for name in replay["types"]]
    assert set(types) == {EVIL}
    assert text.isascii()


def test_hostile_triage_is_text_too(run, tmp_path):
    folder = copied(run, tmp_path / "run")
    read = read_run(folder)
    findings = tuple(replace(f, class_id=EVIL, words=EVIL, fault=EVIL, cause=EVIL, spec=EVIL) for f in read.findings)
    Triage(EVIL, EVIL, 3, findings).write(folder)
    outline = Outline(page([read_run(folder)], 100))
    assert outline.count("script") == 2
    assert outline.count("img") == 0


def test_what_triage_found_is_told(run, tmp_path):
    folder = copied(run, tmp_path / "run")
    read = read_run(folder)
    collisions = [finding for finding in read.findings if finding.spec == "R1"]
    fault = {collisions[0].id: "preventable", collisions[1].id: "npc_rear_end"}
    findings = tuple(
        replace(
            finding,
            same_verdict=finding is not read.findings[-1],
            same_trace=True,
            fault=fault.get(finding.id),
            cause="R1-4" if finding is collisions[0] else None,
        )
        for finding in read.findings
    )
    Triage("intersection-straight", "rule", len(read.entries), findings).write(folder)
    words = plain(page([read_run(folder)], 100))
    assert f"Of {len(collisions)} collisions, the driving system was at fault for 1 and not at fault for 1" in words
    assert "1 failure did not reproduce" in words
    assert "preventable" in words
    assert "R1-4" in words
    assert TRIAGE in words


def test_failures_that_triage_has_not_seen_have_their_class(run, tmp_path):
    """Triage came first, then the campaign was resumed."""
    folder = copied(run, tmp_path / "run")
    whole = read_run(folder)
    Triage("intersection-straight", "x", 3, whole.findings[:1]).write(folder)
    read = read_run(folder)
    assert [finding.class_id for finding in read.findings] == [finding.class_id for finding in whole.findings]
    assert read.examined == {whole.findings[0].id}


def test_the_number_of_replays_is_limited_and_the_page_says_so(run):
    text = page([read_run(run)], 2)
    assert len(data_of(text)["runs"][0]["replays"]) == 2
    assert "The replays of 2 of 24 executions are in this page (at most 2)" in plain(text)
    assert "The replay is not in this page" in plain(text)
    assert data_of(page([read_run(run)], 0))["runs"][0]["replays"] == {}


@pytest.mark.parametrize("limit", [2, 100])
def test_every_link_within_the_page_leads_somewhere(run, harmless_run, limit):
    """To a section, or to a card and to a replay that it has."""
    outline = Outline(page([read_run(run), read_run(harmless_run)], limit))
    ids = {attributes.get("id") for _, attributes in outline.tags}
    classes, replays, last = set(), set(), None
    for _, attributes in outline.tags:
        if "data-class" in attributes:
            last = f"{attributes['data-run']}/{attributes['data-class']}"
            classes.add(last)
        replays |= {f"{last}/{number}" for number in attributes.get("data-replays", "").split()}
    links = {unquote(a["href"][1:]) for tag, a in outline.tags if tag == "a"}
    assert links <= ids | classes | replays
    assert replays <= links or limit == 2


def test_several_runs_stand_side_by_side(run, harmless_run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(run), str(harmless_run)]) == OK
    assert capsys.readouterr().out == f"Report: {PAGE}\n"
    text = (tmp_path / PAGE).read_text()
    words, read = plain(text), read_run(run)
    assert "2 runs side by side" in words
    assert f"{len(read.findings)} ({len(read.findings) / 24:.1%}) 0 (0.0%)" in words
    ids = [attributes["id"] for tag, attributes in Outline(text).tags if tag == "section"]
    assert ids == ["comparison", "1", "2"]
    assert len(data_of(text)["runs"]) == 2


def test_a_run_without_failures_shows_what_came_nearest(harmless_run):
    text = page([read_run(harmless_run)], 100)
    assert "No execution failed." in plain(text)
    (card,) = [attributes for tag, attributes in Outline(text).tags if tag == "article"]
    assert card["data-class"] == "passed"
    degrees = {entry.id: entry.degree for entry in read_run(harmless_run).entries}
    shown = {int(name) for name in data_of(text)["runs"][0]["replays"]}
    assert shown == set(sorted(degrees, key=degrees.get)[: len(shown)])


def test_an_ads_that_failed_has_a_card(run, tmp_path):
    """Its trace has one frame, and nobody touched anything."""
    failure = {"kind": "raised", "message": EVIL}

    def change(record):
        if record["id"] != 3:
            return record
        return {**record, "violated": ["error"], "error": failure, "end": "error", "novelty": None}

    folder = copied(run, tmp_path / "run", change=change)
    with closing(sqlite3.connect(folder / DATABASE, isolation_level=None)) as connection:
        connection.execute("DELETE FROM executions WHERE id = 3")
    connection.close()
    store = Store.read(run)
    execution = store.execution(3)
    store.close()
    whole = execution.load_trace()
    first = {name: getattr(whole, name)[:1] for name in ("time", "position", "heading", "velocity")}
    rest = {name: getattr(whole, name) for name in ("size", "route", "destination", "illegal_lines")}
    trace = Trace(**first, **rest, actions=whole.actions[:0], action_frame=whole.action_frame[:0], end="error")
    store = Store.reopen(folder)
    store.add(Execution(changed(execution.record, change), trace.to_bytes(), 0.0))
    store.commit()
    store.close()
    text = page([read_run(folder)], 100)
    assert "error/raised" in plain(text)
    replay = data_of(text)["runs"][0]["replays"]["3"]
    assert replay["frames"] == 1
    assert replay["mark"] is None
    assert Outline(text).count("script") == 2


def test_figures_that_an_old_record_lacks_are_left_out(run, tmp_path):
    change = lambda record: {key: record[key] for key in ("id", "end", "violated", "scenario")}  # noqa: E731
    text = page([read_run(copied(run, tmp_path / "run", change=change))], 100)
    assert "Novelty" not in plain(text)
    assert "Energy" not in plain(text)


def spoilt(run, folder, how):
    copied(run, folder)
    how(folder)
    return folder


def _flip(folder):
    connection = sqlite3.connect(folder / DATABASE)
    connection.execute("UPDATE executions SET checksum = checksum + 1 WHERE id = 5")
    connection.commit()
    connection.close()


@pytest.mark.parametrize(
    ("how", "message"),
    [
        (shutil.rmtree, "is not a run folder"),
        (lambda folder: (folder / DATABASE).unlink(), "is not a run folder: it has no campaign.db"),
        (
            lambda folder: (folder / TRIAGE).write_text("{"),
            "cannot be read: .*; delete it and run `behavexplor triage` again",
        ),
        (_flip, "Execution 5 in .* is damaged"),
    ],
)
def test_a_damaged_run_is_one_sentence(run, tmp_path, capsys, how, message):
    folder = spoilt(run, tmp_path / "run", how)
    assert main(["report", str(folder), "--out", str(tmp_path / "page.html")]) == BAD_INPUT
    error = capsys.readouterr().err
    assert re.search(message, error)
    assert error.count("\n") == 1
    assert not (tmp_path / "page.html").exists()


@pytest.mark.parametrize(
    "change",
    [
        lambda record: {name: value for name, value in record.items() if name != "scenario"},
        lambda record: {**record, "scenario": {"npcs": [3]}},
        lambda record: {**record, "violated": 1},
    ],
)
def test_a_record_of_another_kind_is_one_sentence(run, tmp_path, capsys, change):
    folder = copied(run, tmp_path / "run")
    with closing(connect(folder / DATABASE, "rw")) as connection:
        record, trace = connection.execute("SELECT record, trace FROM executions WHERE id = 3").fetchone()
        insert(connection, [Row(3, json.dumps(change(json.loads(record))).encode(), trace, 1.0)])
    assert main(["report", str(folder)]) == BAD_INPUT
    error = capsys.readouterr().err
    assert re.search(f"{folder}.* is damaged|{folder}: execution 3 ", error)
    assert error.count("\n") == 1


def test_an_empty_run_is_one_sentence(tmp_path, capsys):
    Store.create(tmp_path / "run", CampaignConfig().to_yaml()).close()
    assert main(["report", str(tmp_path / "run")]) == BAD_INPUT
    assert "has no executions yet: resume it with" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--replays", "-1"], "The number of replays must lie between 0 and 2000, not be -1"),
        (["--out", "/nowhere/at/all.html"], "cannot be written"),
    ],
)
def test_wrong_flags_are_one_sentence(run, capsys, arguments, message):
    assert main(["report", str(run), *arguments]) == BAD_INPUT
    assert message in capsys.readouterr().err


def test_the_folder_of_an_experiment_has_a_page_of_its_own(tmp_path, capsys):
    (tmp_path / "experiment.yaml").write_text("name: a")
    assert main(["report", str(tmp_path)]) == BAD_INPUT
    assert f"its page is {tmp_path / 'report.html'}, which `bench` writes" in capsys.readouterr().err


def test_no_run_at_all_is_one_sentence(capsys):
    assert main(["report"]) == BAD_INPUT
    assert "behavexplor report RUN" in capsys.readouterr().err


LEFT_OUT = "Some are left out here"


def test_what_is_too_large_for_a_page_is_left_out(run, monkeypatch):
    found = read_run(run)
    assert LEFT_OUT not in page([found], 10)
    whole = run_page.section(1, found, "run", 10)
    monkeypatch.setattr(run_page, "MOST_SHOWN", 10)
    without_replays = page([found], 10)
    assert LEFT_OUT in without_replays
    assert "The replay is not in this page" in without_replays
    monkeypatch.setattr(run_page, "MOST_POSITIONS", 1)
    least = run_page.section(1, found, "run", 10)
    assert (len(least.places), least.embedded, least.left_out) == (1, 0, True)
    assert (len(whole.places), whole.left_out) == (len(found.entries), False)
