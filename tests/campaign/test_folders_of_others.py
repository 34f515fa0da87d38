"""Run folders of others: what lies in them leads nowhere else, names no file to delete, and acts on nothing."""

import os
import shutil
import signal
import sqlite3
import struct
import subprocess
import sys
import textwrap
from contextlib import closing

import pytest

from behavexplor.campaign.config import REVISION
from behavexplor.campaign.database_file import AUXILIARY, is_being_written
from behavexplor.campaign.folder_format import CONFIG, DATABASE, FAILURES, LOCK
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.errors import InputError
from tests.campaign.test_store import execution, stored_run

CONFIG_TEXT = f"ads: constant\nenv: lane-follow\nrevision: {REVISION}\n"
MAGIC = bytes.fromhex("d9d505f920a163d7")
PAGE = 4096


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return stored_run(tmp_path_factory.mktemp("runs") / "whole", CONFIG_TEXT, 60)


@pytest.fixture
def folder(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "run")


def resume(folder):
    """Reopen a run and write a failure into it, as a resumed campaign does."""
    store = Store.reopen(folder)
    try:
        store.write_config(CONFIG_TEXT)
        store.add(execution(60, ["collision"]))
        store.commit()
        return len(store)
    finally:
        store.close()


def refused(folder, words, *, reading=True):
    for use in (Store.reopen, *((Store.read,) if reading else ())):
        with pytest.raises(InputError, match=words):
            use(folder)


@pytest.mark.parametrize("name", [f"{CONFIG}.part", f"{FAILURES}/000060.json.part", f"{FAILURES}/000060.json"])
def test_what_is_replaced_is_not_written_through_a_link(folder, canary, name):
    (folder / name).symlink_to(canary)
    assert resume(folder) == 61
    assert not (folder / FAILURES / "000060.json").is_symlink()


@pytest.mark.parametrize("name", [LOCK, DATABASE, *(DATABASE + ending for ending in AUXILIARY)])
def test_a_link_where_a_file_stays_open_is_refused(folder, canary, name):
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(canary)
    refused(folder, f"{name} in it is a symbolic link, which may lead out of it", reading=name != LOCK)
    assert not is_being_written(folder)


@pytest.mark.parametrize("name", [LOCK, *(DATABASE + ending for ending in AUXILIARY)])
def test_a_link_that_leads_nowhere_yet_makes_no_file(folder, tmp_path, name):
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(tmp_path / "new")
    refused(folder, "is a symbolic link", reading=name != LOCK)
    assert not (tmp_path / "new").exists()


def test_a_folder_that_is_a_link_is_refused(folder, tmp_path):
    shutil.rmtree(folder / FAILURES)
    (tmp_path / "elsewhere").mkdir()
    (folder / FAILURES).symlink_to(tmp_path / "elsewhere")
    refused(folder, f"{FAILURES} in it is a symbolic link", reading=False)
    assert not any((tmp_path / "elsewhere").iterdir())


def test_the_folder_itself_may_be_a_link(folder, tmp_path):
    (tmp_path / "mine").symlink_to(folder)
    assert resume(tmp_path / "mine") == 61


@pytest.mark.parametrize("name", [LOCK, DATABASE + "-wal", DATABASE + "-journal"])
def test_a_pipe_is_not_waited_for(folder, name):
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)
    refused(folder, f"{name} in it is not a regular file", reading=name != LOCK)


def killed_in_a_transaction(folder, journal_mode):
    """Leave what a process leaves that was killed in the middle of a transaction, which has spilled to the file."""
    script = f"""
        import os, signal, sqlite3
        connection = sqlite3.connect({str(folder / DATABASE)!r}, isolation_level=None)
        connection.execute("PRAGMA journal_mode = {journal_mode}")
        if "{journal_mode}" == "WAL":
            connection.execute("UPDATE executions SET elapsed = elapsed WHERE id = 0")
        connection.execute("PRAGMA cache_size = 1")
        connection.execute("BEGIN IMMEDIATE")
        connection.execute("UPDATE executions SET record = '{{}}', trace = zeroblob(9000)")
        os.kill(os.getpid(), signal.SIGKILL)
    """
    code = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=False).returncode
    assert code == -signal.SIGKILL


@pytest.mark.parametrize(("journal_mode", "left"), [("DELETE", "-journal"), ("WAL", "-wal")])
def test_a_journal_of_our_own_is_rolled_back(folder, journal_mode, left):
    killed_in_a_transaction(folder, journal_mode)
    assert (folder / (DATABASE + left)).stat().st_size > PAGE
    store = Store.reopen(folder)
    assert [stored.id for stored in store.executions()] == list(range(60))
    assert store.repaired is None
    store.close()


def name_super_journal(journal, victim):
    """Add the record with which a journal names the journal of a transaction over several databases."""
    name = os.fsencode(victim)
    signed = (byte - 256 if byte > 127 else byte for byte in name)
    lock_page = 0x40000000 // PAGE + 1
    record = struct.pack(">I", lock_page) + name + struct.pack(">II", len(name), sum(signed) & 0xFFFFFFFF) + MAGIC
    journal.write_bytes(journal.read_bytes() + record)


def test_a_journal_that_names_a_file_to_delete_is_refused(folder, canary):
    killed_in_a_transaction(folder, "DELETE")
    name_super_journal(folder / f"{DATABASE}-journal", canary)
    refused(folder, "names another journal, which SQLite would delete")


def test_sqlite_would_have_deleted_the_file(folder, tmp_path):
    """So the test before tests what it says."""
    (tmp_path / "victim").write_text("precious")
    killed_in_a_transaction(folder, "DELETE")
    name_super_journal(folder / f"{DATABASE}-journal", tmp_path / "victim")
    connection = sqlite3.connect(folder / DATABASE)
    connection.execute("SELECT count(*) FROM executions")
    connection.close()
    assert not (tmp_path / "victim").exists()


@pytest.mark.parametrize(
    ("statements", "what"),
    [
        ("CREATE TRIGGER t AFTER INSERT ON executions BEGIN DELETE FROM executions; END", "trigger 't'"),
        ("CREATE VIEW v AS SELECT 1", "view 'v'"),
        ("CREATE VIRTUAL TABLE f USING fts5(x)", "table 'f'"),
        ("CREATE TABLE more (x)", "table 'more'"),
        ("CREATE INDEX i ON executions (abs(elapsed))", "index 'i'"),
        ("ALTER TABLE executions ADD COLUMN more TEXT", "table 'executions'"),
        ("ALTER TABLE executions RENAME TO rows; CREATE VIEW executions AS SELECT * FROM rows", "table 'rows'"),
        (
            "PRAGMA writable_schema = ON; UPDATE sqlite_schema SET sql = replace(sql, '$.novelty''))', "
            "'$.novelty'') || (SELECT 1))')",
            "table 'executions'",
        ),
        (
            "PRAGMA writable_schema = ON; UPDATE sqlite_schema SET sql = replace(sql, '''$.end''', "
            "'''--'' || char(1) || ''' || char(10) || '$.end''')",
            "table 'executions'",
        ),
    ],
)
def test_a_foreign_schema_is_refused(folder, statements, what):
    with closing(sqlite3.connect(folder / DATABASE, isolation_level=None)) as connection:
        connection.executescript(statements)
    connection.close()
    before = (folder / DATABASE).read_bytes()
    is_ours = what == "table 'executions'"  # which must not be dropped
    mend = "restore it from a copy" if is_ours else f"if it is your own, drop the {what.split()[0]}"
    refused(folder, rf"has the {what}, which this version of behavexplor does not make so: .*; {mend}")
    assert (folder / DATABASE).read_bytes() == before
    assert not (folder / f"{DATABASE}.damaged").exists()


@pytest.mark.parametrize("command", [["report"], ["triage"], ["minimize"], ["replay", "0"]])
def test_no_command_writes_through_a_link(folder, canary, capsys, command):
    elsewhere = canary.parent / "elsewhere"
    elsewhere.mkdir()
    for name in ("report.html", "report.html.part", "triage.json.part"):
        (folder / name).symlink_to(canary)
    for name in ("replays", "minimized", "witnesses"):
        (folder / name).symlink_to(elsewhere)
    if command[0] == "replay":  # of an unknown road, which a trace of any kind may have
        (folder / CONFIG).write_text(CONFIG_TEXT.replace("lane-follow", "nowhere-v0"))
    code = main([command[0], str(folder), *command[1:]])
    assert not any(elsewhere.iterdir())
    assert code == (OK if command == ["report"] else BAD_INPUT)
    assert command == ["report"] or "in it is a symbolic link" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["minimized/000000.json", "triage.json", "road.json", CONFIG])
def test_no_command_waits_for_a_pipe(folder, capsys, name):
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)
    main(["report", str(folder)])
    main(["status", str(folder)])
    assert "Traceback" not in capsys.readouterr().err
