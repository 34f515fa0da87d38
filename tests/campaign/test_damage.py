"""Damaged, unfinished, foreign and full run folders: read as far as they go, mended on resuming, and named."""

import json
import os
import resource
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from behavexplor.campaign.campaign import ExecutionError
from behavexplor.campaign.config import REVISION, CampaignConfig
from behavexplor.campaign.folder_format import CONFIG, DATABASE, FAILURES, LOCK, Losses
from behavexplor.campaign.opening import opened
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, EXECUTION_FAILED, OK, main
from behavexplor.errors import InputError
from tests.campaign.test_store import execution, stored_run

ROOT = Path(__file__).parents[2]
CAMPAIGN = ["fuzz", "--ads", "constant:1", "--env", "lane-follow", "--method", "uniform", "--seed", "7", "--quiet"]
CAMPAIGN_CONFIG = f"ads: constant\nenv: lane-follow\nrevision: {REVISION}\n"
COUNT = 120
ON_DISK = 200  # executions, of 8 kB each, of which a megabyte holds at least the first commit of 50


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run folder of many executions, every third a failure."""
    return stored_run(tmp_path_factory.mktemp("runs") / "whole", CAMPAIGN_CONFIG, COUNT)


@pytest.fixture
def folder(whole, tmp_path):
    return Path(shutil.copytree(whole, tmp_path / "copy"))


def change(folder, statement):
    with closing(sqlite3.connect(folder / DATABASE, isolation_level=None)) as connection:
        connection.execute(statement)
    connection.close()


def read(folder):
    """The numbers of the records that can be read, and what is said to be lost."""
    store, losses = Store.read(folder), Losses()
    numbers = [record.id for record in store.records(losses)]
    store.close()
    return numbers, losses.sentences(folder)


def test_a_whole_folder_has_lost_nothing(whole):
    assert read(whole) == (list(range(COUNT)), [])


def test_records_are_checked_without_their_traces(folder):
    change(folder, "UPDATE executions SET record = replace(record, 'arrived', 'timeout') WHERE id = 5")
    change(folder, "UPDATE executions SET elapsed = 1e9 WHERE id = 6")
    change(folder, "UPDATE executions SET trace = zeroblob(9) WHERE id = 7")
    numbers, said = read(folder)
    assert set(range(COUNT)) - set(numbers) == {5, 6}
    assert said == [f"Damaged or missing in {folder / DATABASE}: executions 5 to 6; fuzz --resume executes that again"]
    store = Store.read(folder)
    with pytest.raises(InputError, match=r"Execution 7 in .* is damaged"):
        store.execution(7)
    with pytest.raises(InputError, match=r"Execution 5 in .* is damaged"):
        list(store.records())
    store.close()


def test_missing_rows_and_files_are_named(folder):
    change(folder, "DELETE FROM executions WHERE id IN (0, 50, 51)")
    for number in (3, 6, 9, 30):
        (folder / FAILURES / f"{number:06d}.json").unlink()
    (folder / CONFIG).unlink()
    numbers, said = read(folder)
    assert len(numbers) == COUNT - 3
    assert [sentence.partition(": ")[2] for sentence in said[:2]] == [
        "executions 0, 50 to 51; fuzz --resume executes that again",
        "files of executions 3, 6, 9, 30; fuzz --resume writes them",
    ]
    assert said[2].startswith(f"{folder / CONFIG} is missing")


@pytest.mark.parametrize("left", [0.98, 0.6, 0.3])
def test_a_database_that_was_cut_off_is_read_as_far_as_it_goes(folder, left):
    size = int((folder / DATABASE).stat().st_size * left)
    os.truncate(folder / DATABASE, size)
    numbers, said = read(folder)
    assert COUNT * left * 0.8 <= len(numbers) < COUNT
    assert len(said) == 1
    store = Store.reopen(folder)
    assert [stored.id for stored in store.executions()] == numbers
    assert f"{len(numbers)} executions were saved" in store.repaired
    assert (folder / f"{DATABASE}.damaged").stat().st_size == size
    store.close()
    again = Store.reopen(folder)
    assert again.repaired is None
    again.close()


@pytest.mark.parametrize("seed", range(20))
def test_overwritten_bytes_are_noticed_and_no_other_row_is_lost_for_them(folder, seed):
    """What is read is what was written, whatever page is hit; a page holds a handful of rows, an inner one many."""
    rng = np.random.default_rng(seed)
    data = bytearray((folder / DATABASE).read_bytes())
    place = int(rng.integers(4096, len(data) - 64))
    data[place : place + 64] = rng.bytes(64)
    (folder / DATABASE).write_bytes(data)
    store, losses = Store.read(folder), Losses()
    records = {record.id: record for record in store.records(losses)}
    store.close()
    assert all(record == execution(n, ["collision"] if n % 3 == 0 else []).record for n, record in records.items())
    assert len(records) + len(losses.damaged) == COUNT or losses.cut_off
    mended = Store.reopen(folder)
    recalled = [number for number in range(COUNT) if mended.recall(number) is not None]
    mended.close()
    assert len(recalled) >= COUNT * 0.5
    assert set(recalled) <= set(records)


def test_what_is_no_database_is_kept_and_begun_anew(folder):
    (folder / DATABASE).write_bytes(b"rubbish" * 1000)
    with pytest.raises(InputError, match="cannot be read: file is not a database"):
        Store.read(folder)
    store = Store.reopen(folder)
    assert (len(store), store.repaired.partition(": ")[2][:25]) == (0, "0 executions were saved, ")
    store.close()
    assert (folder / f"{DATABASE}.damaged").read_bytes() == b"rubbish" * 1000


def test_a_newer_format_is_left_alone(folder):
    change(folder, "UPDATE meta SET value = '10'")
    before = (folder / DATABASE).read_bytes()
    for opening in (Store.read, Store.reopen):
        with pytest.raises(
            InputError, match=r"has format 10, but this version reads 3: another version of behavexplor wrote it"
        ):
            opening(folder)
    assert (folder / DATABASE).read_bytes() == before


def test_a_table_that_is_none_is_refused(folder):
    """A view could compute for ever."""
    change(folder, "ALTER TABLE executions RENAME TO rows")
    change(folder, "CREATE VIEW executions AS SELECT * FROM rows")
    with pytest.raises(InputError, match="has the table 'rows', which this version of behavexplor does not make"):
        Store.read(folder)


@pytest.mark.parametrize("left", ["nothing", "database", "header", "tables"])
def test_a_run_that_was_ended_while_it_was_made_can_be_resumed(tmp_path, left):
    store = Store.create(tmp_path / "run", CAMPAIGN_CONFIG)
    store.close()
    if left == "nothing":
        (tmp_path / "run" / DATABASE).unlink()
        (tmp_path / "run" / FAILURES).rmdir()
    elif left == "database":
        (tmp_path / "run" / DATABASE).write_bytes(b"")
    elif left == "header":
        (tmp_path / "run" / DATABASE).unlink()
        with closing(sqlite3.connect(tmp_path / "run" / DATABASE, isolation_level=None)) as connection:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA user_version = 0")
        connection.close()
    if left in ("database", "header"):
        with pytest.raises(InputError, match="the run has not begun: fuzz --resume begins it"):
            Store.read(tmp_path / "run")
    again = Store.reopen(tmp_path / "run")
    again.add(execution(0, ["collision"]))
    again.commit()
    assert (len(again), again.repaired) == (1, None)
    again.close()


def test_a_folder_in_which_only_a_lock_was_made_is_empty(tmp_path):
    for name in (LOCK, f"{CONFIG}.part"):
        (tmp_path / name).write_text("en")
    store = Store.create(tmp_path, CAMPAIGN_CONFIG)
    assert (tmp_path / CONFIG).read_text() == CAMPAIGN_CONFIG
    store.close()


def read_records(folder):
    store = Store.read(folder)
    records = [record.to_dict() for record in store.records()]
    store.close()
    return records


def test_what_a_run_has_lost_is_executed_again(tmp_path, capsys):
    run = [*CAMPAIGN, "--budget", "6", "--workers", "0", "--out", str(tmp_path / "run")]
    assert main(run) == OK
    before = read_records(tmp_path / "run")
    change(tmp_path / "run", "DELETE FROM executions WHERE id = 1")
    change(tmp_path / "run", "UPDATE executions SET trace = zeroblob(9) WHERE id = 4")
    shutil.rmtree(tmp_path / "run" / FAILURES)
    capsys.readouterr()
    assert main(["records", str(tmp_path / "run")]) == BAD_INPUT
    shown = capsys.readouterr()
    assert len(shown.out.splitlines()) == 5
    assert [" ".join(line.partition(": ")[2].split()[:2]) for line in shown.err.splitlines()] == [
        "Damaged or",
        "Lost in",
    ]
    assert main(["fuzz", "--resume", str(tmp_path / "run"), "--workers", "0", "--quiet"]) == OK
    capsys.readouterr()
    assert main(["records", str(tmp_path / "run")]) == OK
    after = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [{name: value for name, value in record.items() if name != "at_fault"} for record in after] == before
    assert [record["id"] for record in after if "at_fault" in record] == [r["id"] for r in before if r["violated"]]
    failed = [record["id"] for record in before if record["violated"]]
    assert sorted(path.name for path in (tmp_path / "run" / FAILURES).iterdir()) == [f"{n:06d}.json" for n in failed]


def fuzz(*arguments, file_size=None, prefix=()):
    """The program in a process of its own, whose files may grow to a size."""
    limit = None if file_size is None else lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (file_size, file_size))
    command = [*prefix, sys.executable, "-m", "behavexplor", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        command, capture_output=True, text=True, env=environment, timeout=120, check=False, preexec_fn=limit
    )


@pytest.mark.parametrize("workers", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_full_disk_ends_the_campaign_and_keeps_what_was_recorded(tmp_path, workers):
    run = tmp_path / "run"
    result = fuzz(*CAMPAIGN, "--budget", ON_DISK, "--workers", workers, "--out", run, file_size=1_000_000)
    assert result.returncode == EXECUTION_FAILED
    assert "Traceback" not in result.stderr
    assert "The campaign can no longer write to disk: " in result.stderr.splitlines()[-1]
    kept = read_records(run)
    assert 0 < len(kept) < ON_DISK
    assert f"{len(kept)} executions in " in result.stdout
    assert main(["fuzz", "--resume", str(run), "--workers", "0", "--quiet"]) == OK
    assert main([*CAMPAIGN, "--budget", str(ON_DISK), "--workers", "0", "--out", str(tmp_path / "whole")]) == OK
    assert read_records(run) == read_records(tmp_path / "whole")


def test_a_disk_that_is_full_from_the_beginning_is_one_sentence(tmp_path):
    result = fuzz(*CAMPAIGN, "--budget", 4, "--workers", 0, "--out", tmp_path / "run", file_size=100)
    assert (result.returncode, result.stderr.count("\n")) == (BAD_INPUT, 1)
    assert "The run folder" in result.stderr
    assert "cannot be written" in result.stderr


MOUNT = ["unshare", "--user", "--map-root-user", "--mount", "--fork"]
CAN_MOUNT = (
    shutil.which("unshare") and not subprocess.run([*MOUNT, "true"], check=False, capture_output=True).returncode
)


@pytest.mark.skipif(not CAN_MOUNT, reason="needs namespaces of its own to mount in")
def test_a_real_disk_that_runs_full(tmp_path):
    (tmp_path / "disk").mkdir()
    prefix = [*MOUNT, "sh", "-c", f'mount -t tmpfs -o size=1000k none {tmp_path}/disk && "$@"; code=$?; '
              f"cp -r {tmp_path}/disk/run {tmp_path}/kept; exit $code", "sh"]  # fmt: skip
    result = fuzz(*CAMPAIGN, "--budget", ON_DISK, "--workers", 0, "--out", tmp_path / "disk" / "run", prefix=prefix)
    assert result.returncode == EXECUTION_FAILED, result.stderr
    assert "Traceback" not in result.stderr
    assert "database or disk is full" in result.stderr or "No space left" in result.stderr
    kept = read_records(tmp_path / "kept")
    assert 0 < len(kept) < ON_DISK
    assert f"{len(kept)} executions in " in result.stdout


@pytest.mark.skipif(not CAN_MOUNT, reason="needs namespaces of its own to mount in")
def test_a_folder_that_cannot_be_written_can_be_read(tmp_path, whole):
    shutil.copytree(whole, tmp_path / "run")
    here = tmp_path / "run"
    prefix = [*MOUNT, "sh", "-c", f'mount --bind -o ro {here} {here} && mount -o remount,ro,bind {here} && "$@"', "sh"]
    result = fuzz("records", here, prefix=prefix)
    assert (result.returncode, len(result.stdout.splitlines())) == (OK, COUNT)
    resumed = fuzz("fuzz", "--resume", here, "--workers", 0, prefix=prefix)
    assert resumed.returncode == BAD_INPUT
    assert resumed.stderr.splitlines()[-1].endswith("cannot be written: Read-only file system")
    begun = fuzz("fuzz", "--ads", "constant", "--workers", 0, "--out", here / "new", prefix=prefix)
    assert begun.returncode == BAD_INPUT
    assert begun.stderr.splitlines()[-1].endswith("cannot be written: Read-only file system")
    assert [path.name for path in here.iterdir()] == [path.name for path in whole.iterdir()]


@pytest.mark.parametrize("deleted", ["", DATABASE])
def test_a_folder_that_is_deleted_while_a_campaign_runs_is_named(deleted, tmp_path):
    store = Store.create(tmp_path / "run", CAMPAIGN_CONFIG)
    store.add(execution(0, []))
    assert store.lost is None
    (tmp_path / "run" / deleted).rename(tmp_path / "other")
    with pytest.raises(FileNotFoundError, match="was deleted or moved") as raised:
        store.commit()
    assert str(raised.value).startswith(f"{tmp_path / 'run' / deleted} ")
    store.close()


def test_a_campaign_that_cannot_write_raises_what_all_commands_report(tmp_path):
    config = CampaignConfig(env="lane-follow", ads="constant", method="uniform", budget="200")
    with opened(config, tmp_path / "run", 0, resume=False) as ready:
        with pytest.raises(ExecutionError, match=r"can no longer write to disk: .*run was deleted or moved"):
            ready.campaign.run(lambda _: (tmp_path / "run").rename(tmp_path / "other"))
        assert len(read_records(tmp_path / "other")) == ready.campaign.progress.executions > 0
