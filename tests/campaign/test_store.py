"""Run folders: durable, readable while written, and honest about damage."""

import json
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from behavexplor.campaign.database_rows import rebuild
from behavexplor.campaign.folder_format import DATABASE, Losses, failure_path
from behavexplor.campaign.record import Record, WrittenValues
from behavexplor.campaign.store import Execution, Store
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.errors import InputError
from tests.strategies import random_trace

TRACES = [random_trace(seed).to_bytes() for seed in range(3)]


def execution(number, violated=(), violation_class=None):
    record = Record(
        id=number,
        violated=tuple(violated),
        violation_class=violation_class,
        degree=0.1 * number,
        degrees={"collision": 0.1 * number},
        novelty=0.5,
        end="arrived",
        scenario=ScriptedScenario("intersection-straight", ()).to_dict(),
    )
    return Execution(record, TRACES[number % 3], 1.5 * number)


def stored_run(folder, config, count):
    """Make a run folder of some executions, every third a failure."""
    store = Store.create(folder, config)
    for number in range(count):
        store.add(execution(number, ["collision"] if number % 3 == 0 else []))
    store.commit()
    store.close()
    return folder


@pytest.fixture
def store(tmp_path):
    store = Store.create(tmp_path / "run", "env: x\n")
    yield store
    store.close()


def filled(store, count=3):
    for number in range(count):
        store.add(execution(number))
    store.commit()
    return store


def test_executions_come_back_as_they_were(store):
    filled(store)
    assert list(store.executions()) == [execution(0), execution(1), execution(2)]
    assert store.execution(1) == execution(1)
    assert store.execution(1).load_trace().to_bytes() == TRACES[1]
    assert (store.folder / "config.yaml").read_text() == "env: x\n"


def test_what_is_not_committed_does_not_count(store):
    store.add(execution(0))
    assert (len(store), store.pending) == (0, 1)
    assert store.commit() == [execution(0)]
    assert (len(store), store.pending) == (1, 0)
    assert store.commit() == []


def test_a_reader_sees_the_committed_while_a_campaign_writes(store):
    filled(store)
    reader = Store.read(store.folder)
    store.add(execution(3))
    assert len(reader) == 3
    store.commit()
    assert len(reader) == 4
    reader.close()


def test_ordinary_tools_can_read_it(store):
    filled(store)
    with closing(sqlite3.connect(store.folder / DATABASE, isolation_level=None)) as connection:
        rows = connection.execute('SELECT id, degree, novelty, "end", violated FROM executions').fetchall()
    connection.close()
    assert rows[1] == (1, 0.1, 0.5, "arrived", "[]")


def test_each_failure_has_a_file(store):
    store.add(execution(0))
    store.add(execution(1, ["collision"]))
    store.commit()
    assert json.loads(failure_path(store.folder, 1).read_text()) == execution(1, ["collision"]).record.to_dict()
    assert [path.name for path in (store.folder / "failures").iterdir()] == ["000001.json"]


@pytest.mark.parametrize("lose", [Path.unlink, lambda path: path.write_text("")], ids=["missing", "empty"])
def test_the_file_of_a_failure_that_a_power_cut_took_is_written_again(store, lose):
    store.add(execution(0, ["collision"]))
    store.commit()
    path = failure_path(store.folder, 0)
    text = path.read_text()
    lose(path)
    losses = Losses()
    assert [record.id for record in store.records(losses)] == losses.files == [0]
    assert store.recall(0).id == 0
    assert path.read_text() == text


def test_a_folder_that_holds_something_is_not_overwritten(tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(InputError, match="is not empty"):
        Store.create(tmp_path, "")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        Store.create(tmp_path / "file", "")


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="is not a run folder"):
        Store.read(tmp_path)


def test_a_file_that_is_no_database_is_refused(tmp_path):
    (tmp_path / DATABASE).write_bytes(b"rubbish" * 1000)
    with pytest.raises(InputError, match="cannot be read"):
        Store.read(tmp_path)


def test_another_format_is_refused(store):
    with closing(sqlite3.connect(store.folder / DATABASE, isolation_level=None)) as connection:
        connection.execute("UPDATE meta SET value = '99'")
    connection.close()
    with pytest.raises(InputError, match="has format 99"):
        Store.read(store.folder)


@pytest.mark.parametrize("change", ["trace = zeroblob(10)", "record = replace(record, 'arrived', 'crashed')", "id = 7"])
def test_damage_is_named(store, change):
    filled(store)
    with closing(sqlite3.connect(store.folder / DATABASE, isolation_level=None)) as connection:
        connection.execute(f"UPDATE executions SET {change} WHERE id = 2")
    connection.close()
    executions = store.executions()
    assert [next(executions).id, next(executions).id] == [0, 1]
    with pytest.raises(InputError, match=r"Execution 2 in .* is damaged or missing"):
        next(executions)


def test_a_damaged_record_is_named(store):
    filled(store).close()
    path = store.folder / DATABASE
    path.write_bytes(path.read_bytes().replace(b'{"id": 1', b'["id": 1'))
    damaged = Store.read(store.folder)
    with pytest.raises(InputError, match="is damaged"):
        list(damaged.records())
    damaged.close()


def test_damaged_databases_are_kept_beside_each_other(tmp_path):
    for name in ("campaign.db", "campaign.db.damaged2"):  # the first one of two was deleted
        (tmp_path / name).write_text(name)
    assert [rebuild(tmp_path / "campaign.db")[1].name for _ in range(2)] == [
        "campaign.db.damaged",
        "campaign.db.damaged3",
    ]


def test_a_missing_execution_is_named(store):
    with pytest.raises(InputError, match="has no execution 9: it has 3"):
        filled(store).execution(9)


def test_a_run_can_be_reopened(store):
    filled(store)
    store.close()
    again = Store.reopen(store.folder)
    again.add(execution(3))
    again.commit()
    assert len(again) == 4
    again.close()


def test_a_record_whose_outcome_and_scenario_are_written_is_the_same():
    whole = replace(execution(3).record, origin="one, two", parent=2, search={"energy": [0.5, None], "kept": True})
    outcome = whole.members[3:-4]
    made = replace(whole, scenario=WrittenValues(json.dumps(whole.scenario)))
    for record in (made, whole):
        assert record.members_around(outcome) == whole.members
    assert "_values" not in vars(made.scenario)  # nothing has been read until now
    assert made.to_json() == whole.to_json()
    assert (made, made.load_scenario()) == (whole, whole.load_scenario())
    assert made.to_dict() == whole.to_dict()


def test_a_database_without_a_format_is_not_written(store):
    filled(store).close()
    changed(store.folder / DATABASE, "DELETE FROM meta")
    for use in (Store.read, Store.reopen):
        with pytest.raises(InputError, match="has format none, but this version reads 3: it is damaged"):
            use(store.folder)


def test_a_record_of_an_earlier_version_may_have_fewer_fields():
    record = Record.from_json('{"id": 4, "end": "arrived", "violated": [], "scenario": {}, "later": 1}')
    assert (record.id, record.end, record.failed, record.novel) == (4, "arrived", False, False)
    assert record.degrees == record.search == {}
    for wrong in ('{"id": "4", "end": "arrived", "violated": [], "scenario": {}}', '{"id": 4}', "[]", ""):
        with pytest.raises(ValueError, match=r"id|end|record"):
            Record.from_json(wrong)


def settings_of(connection):
    names = ("journal_mode", "synchronous", "trusted_schema", "cell_size_check")
    return [connection.execute(f"PRAGMA {name}").fetchone()[0] for name in names]


def test_what_is_written_is_on_disk_and_what_is_read_runs_no_functions_of_a_schema(store):
    """With `synchronous` at 2 ("full"), a commit survives a power cut."""
    filled(store)
    assert settings_of(store._connection) == [b"wal", 2, 1, 1]
    reader = Store.read(store.folder)
    assert settings_of(reader._connection)[2:] == [0, 1]
    with pytest.raises(sqlite3.OperationalError, match="readonly"):
        reader._connection.execute("DELETE FROM executions")
    reader.close()


@pytest.mark.parametrize("change", ["record = 5", "trace = 5", "elapsed = 'soon'", "record = NULL", "checksum = 'x'"])
def test_a_value_of_a_wrong_type_is_damage(tmp_path, change):
    """SQLite checks types when it writes, so the table is written as one of another kind."""
    folder = stored_run(tmp_path / "run", "env: x\n", 3)
    with closing(sqlite3.connect(folder / DATABASE, isolation_level=None)) as connection:
        connection.execute("PRAGMA writable_schema = ON")
        edit = "UPDATE sqlite_schema SET sql = ? WHERE name = 'executions'"
        (ours,) = connection.execute("SELECT sql FROM sqlite_schema WHERE name = 'executions'").fetchone()
        connection.execute(edit, (ours.replace("STRICT", "").replace("NOT NULL", ""),))
        connection.execute("PRAGMA schema_version = 99")
        connection.execute("PRAGMA writable_schema = RESET")
        connection.execute(f"UPDATE executions SET {change} WHERE id = 1")
        connection.execute("PRAGMA writable_schema = ON")
        connection.execute(edit, (ours,))
    connection.close()
    reader = Store.read(folder)
    assert [number for number in range(3) if reader.recall(number) is not None] == [0, 2]
    with pytest.raises(InputError, match=r"Execution 1 in .* is damaged"):
        list(reader.executions())
    losses, is_read = Losses(), change.startswith(("trace", "checksum"))  # without the trace
    assert [record.id for record in reader.records(losses)] == ([0, 1, 2] if is_read else [0, 2])
    assert losses.damaged == ([] if is_read else [1])
    reader.close()


def open_files(folder):
    """Files of a folder that this process holds open."""
    files = [file.readlink() for file in Path("/proc/self/fd").iterdir() if file.exists()]
    return [file.name for file in files if file.parent == folder]


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs the files in /proc")
@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(b"rubbish" * 1000),
        lambda path: path.write_bytes(b""),
        lambda path: changed(path, "UPDATE meta SET value = '99'"),
        lambda path: changed(path, "DELETE FROM meta"),
        lambda path: changed(path, "CREATE TABLE more (x)"),
        lambda path: (path.parent / "failures").rename(path.parent / "gone").joinpath("..", "failures").write_text(""),
    ],
    ids=["rubbish", "empty", "format", "no-format", "table", "failures"],
)
@pytest.mark.parametrize("use", [Store.read, Store.reopen])
def test_a_run_that_is_refused_is_not_held_open(tmp_path, spoil, use):
    folder = stored_run(tmp_path / "run", "env: x\n", 3)
    spoil(folder / DATABASE)
    try:
        use(folder).close()
    except InputError:  # while it is handled, what was opened is not yet collected
        assert open_files(folder) == []
    assert open_files(folder) == []


def changed(path, statement):
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute(statement)
    connection.close()
