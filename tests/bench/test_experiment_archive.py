"""The archive of an experiment: tables without run folders, and experiments in parts."""

import gzip
import json
import shutil

import pytest

from behavexplor.bench.experiment import read_experiment
from behavexplor.bench.experiment_archive import ARCHIVE, read_archive
from behavexplor.bench.summaries import summarize
from behavexplor.commands import main
from behavexplor.errors import InputError

TEXT = """
envs: [intersection-straight, lane-follow]
ads: ["tests.drivers:cruiser"]
methods:
  BehAVExplor: {config: paper}
  Uniform: {method: uniform}
seeds: 1
budget: 20
baseline: Uniform
unconfined: true
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The file and the folder of a finished experiment."""
    folder = tmp_path_factory.mktemp("whole")
    file = folder / "small.yaml"
    file.write_text(TEXT)
    assert main(["bench", str(file), "--out", str(folder / "out"), "--quiet", "--unconfined"]) == 0
    return file, folder / "out"


def moved(whole, folder):
    """Return a new folder with what an experiment needs to continue, but no run folders."""
    folder.mkdir()
    for name in ("experiment.yaml", ARCHIVE):
        shutil.copy(whole[1] / name, folder / name)
    return folder


def files(root):
    found = [path for path in root.rglob("*") if path.is_file() and "runs" not in path.relative_to(root).parts]
    return {str(path.relative_to(root)): path.read_bytes() for path in found}


def test_an_archived_campaign_is_what_its_run_folder_says(whole, tmp_path):
    file, root = whole
    runs = read_experiment(str(file)).runs()
    assert read_archive(runs, moved(whole, tmp_path / "out")) == {run: summarize(run, root) for run in runs}
    assert read_archive(runs, root) == {}  # run folders come first


def test_all_files_are_made_again_from_the_archive_alone(whole, tmp_path, capsys):
    file, root = whole
    folder = moved(whole, tmp_path / "out")
    assert main(["bench", str(file), "--out", str(folder), "--tables-only", "--quiet"]) == 0
    assert "4 of 4 campaigns finished" in capsys.readouterr().out
    assert files(folder) == files(root)


def test_an_experiment_continues_from_the_archive(whole, tmp_path, capsys):
    file, _ = whole
    more = tmp_path / "small.yaml"
    more.write_text(TEXT.replace("seeds: 1", "seeds: 2"))
    folder = moved(whole, tmp_path / "out")
    assert main(["bench", str(more), "--out", str(folder), "--dry-run", "--unconfined"]) == 0
    assert "4 finished; 80 executions left" in capsys.readouterr().out
    assert main(["bench", str(more), "--out", str(folder), "--quiet", "--unconfined"]) == 0
    assert "8 of 8 campaigns finished" in capsys.readouterr().out
    assert not list(folder.glob("runs/*/*/*/1"))
    assert len(list(folder.glob("runs/*/*/*/2"))) == 4
    archived = read_archive(read_experiment(str(more)).runs(), moved((more, folder), tmp_path / "again"))
    assert [run.seed for run in archived] == [1] * 4 + [2] * 4
    assert main(["bench", str(file), "--out", str(folder), "--tables-only", "--quiet"]) == 0
    assert len(gzip.decompress((folder / ARCHIVE).read_bytes()).splitlines()) == 8  # the second seed is kept


def test_a_greater_budget_runs_an_archived_campaign_again(whole, tmp_path):
    file = tmp_path / "small.yaml"
    file.write_text(TEXT.replace("budget: 20", "budget: 25"))
    runs = read_experiment(str(file)).runs()
    assert read_archive(runs, moved(whole, tmp_path / "out")) == {}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("budget: 20", "budget: 10"), "has a budget of 20 executions, and the experiment one of 10"),
        (("seeds: 1", "seeds: 1\nbatch: 3"), "holds a campaign with a different configuration"),
    ],
)
def test_an_archive_of_another_experiment_is_refused(whole, tmp_path, change, message):
    file = tmp_path / "small.yaml"
    file.write_text(TEXT.replace(*change))
    with pytest.raises(InputError, match=message):
        read_archive(read_experiment(str(file)).runs(), moved(whole, tmp_path / "out"))


def test_a_damaged_campaign_is_named(whole, tmp_path):
    runs, folder = read_experiment(str(whole[0])).runs(), moved(whole, tmp_path / "out")
    first, *rest = gzip.decompress((folder / ARCHIVE).read_bytes()).decode().splitlines()
    line = json.loads(first)
    for change, message in (
        ({"config": ["x"]}, f"{ARCHIVE} is damaged"),
        ({"summary": 3}, f"{ARCHIVE} is damaged"),
        ({"config": {**line["config"], "budget": "2h"}}, "has a budget of 2h executions"),
        ({"summary": {**line["summary"], "seed": "x"}}, "seed of the"),
    ):
        (folder / ARCHIVE).write_bytes(gzip.compress("\n".join([json.dumps({**line, **change}), *rest]).encode()))
        with pytest.raises(InputError, match=message):
            read_archive(runs, folder)


@pytest.mark.parametrize(
    "damage",
    [b"", b"no archive", gzip.compress(b"{}\n"), gzip.compress(b"[]")],
    ids=["empty", "text", "without a run", "no campaign"],
)
def test_a_damaged_archive_is_named(whole, tmp_path, capsys, damage):
    folder = moved(whole, tmp_path / "out")
    (folder / ARCHIVE).write_bytes(damage)
    assert main(["bench", str(whole[0]), "--out", str(folder), "--tables-only", "--quiet"]) == 2
    assert f"{ARCHIVE} is damaged" in capsys.readouterr().err
