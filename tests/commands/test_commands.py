"""The commands as a user runs them: what they print, their exit codes, and what is left after an interruption."""

import errno
import io
import json
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from PIL import Image

from behavexplor import commands
from behavexplor.campaign.campaign import ExecutionError
from behavexplor.campaign.config import stored_config
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, EXECUTION_FAILED, INTERNAL_ERROR, OK, main
from behavexplor.commands.evaluate import _gap
from behavexplor.errors import InputError
from behavexplor.evaluation import Evaluation
from behavexplor.fuzz.uniform import Uniform
from behavexplor.report import drawing
from tests.campaign.test_store import stored_run

ROOT = Path(__file__).parents[2]
BEGUN = ["fuzz", "--workers", "0", "--unconfined"]
FUZZ = [*BEGUN, "--ads", "tests.drivers:cruiser"]
WITH_WORKERS = ["fuzz", "--unconfined"]
ENDLESS = [*WITH_WORKERS, "--ads", "tests.drivers:cruiser", "--budget", "400"]


def run(*arguments):
    """A command in this process: its exit code and what it prints."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = main(list(map(str, arguments)))
        except SystemExit as ended:  # as the parser of the flags ends the process
            code = ended.code
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


def run_apart(*arguments, cwd=ROOT):
    """The program in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "behavexplor", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=120, check=False)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run with failures, and what fuzzing printed."""
    folder = tmp_path_factory.mktemp("runs") / "finished"
    result = run(*FUZZ, "--budget", 12, "--seed", 5, "--method", "uniform", "--out", folder)
    assert result.returncode == 0, result.stderr
    return folder, result


def records(folder):
    result = run("records", folder)
    assert result.returncode == 0, result.stderr
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_the_summary_says_what_failed_and_how_to_look_at_it(finished):
    folder, result = finished
    failed = [record["id"] for record in records(folder) if record["violated"]]
    assert result.stdout.startswith("12 executions in ")
    assert f"{len(failed)} failed" in result.stdout
    assert f"All results are in {folder}" in result.stdout
    assert f"replay {folder} {failed[0]}" in result.stdout


def test_records_are_one_json_object_a_line(finished):
    folder, _ = finished
    lines = records(folder)
    assert [record["id"] for record in lines] == list(range(12))
    assert all({"violated", "degree", "novelty", "end"} <= record.keys() for record in lines)


@pytest.mark.parametrize("extra", [["--workers", "2"], ["--workers", "0", "--quiet"]])
def test_the_same_seed_prints_the_same_records(finished, tmp_path, extra):
    folder, _ = finished
    flags = ["--ads", "tests.drivers:cruiser", "--budget", 12, "--seed", 5, "--method", "uniform", *extra]
    result = run(*WITH_WORKERS, *flags, "--out", tmp_path / "again")
    assert result.returncode == 0
    assert run("records", tmp_path / "again").stdout == run("records", folder).stdout


def test_the_stored_configuration_makes_the_same_run(finished, tmp_path):
    folder, _ = finished
    flags = ["--config", folder / "config.yaml", "--unconfined"]  # which counts on the command line only
    result = run("fuzz", *flags, "--workers", 1, "--out", tmp_path / "again")
    assert result.returncode == 0
    assert run("records", tmp_path / "again").stdout == run("records", folder).stdout


@pytest.mark.parametrize("name", ["unconfined", "stochastic", "confirm"])
@pytest.mark.parametrize("value", [True, False])
def test_a_switch_overrides_the_configuration_in_both_directions(tmp_path, name, value):
    (tmp_path / "config.yaml").write_text(f"ads: learned:intersection-straight\nbudget: 1\n{name}: {not value}\n")
    flags = ["--config", tmp_path / "config.yaml", "--workers", 0, "--quiet"]
    said = [] if name == "unconfined" and not value else [([], not value)]  # which a file cannot say alone
    for given, expected in (*said, ([f"--{'' if value else 'no-'}{name}"], value)):
        folder = tmp_path / f"run{len(given)}"
        assert run("fuzz", *flags, *given, "--out", folder).returncode == 0
        assert getattr(stored_config(folder).unverified, name) is expected


def test_the_fuzz_package_is_the_fuzz_command(tmp_path):
    command = [sys.executable, "-m", "behavexplor.fuzz", *FUZZ[1:], "--budget", "2", "--out", str(tmp_path / "a")]
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=120, check=False)
    assert result.returncode == 0
    assert len(records(tmp_path / "a")) == 2


def test_a_failure_is_replayed_to_pictures(finished, tmp_path):
    folder, _ = finished
    number = next(record["id"] for record in records(folder) if "collision" in record["violated"])
    result = run("replay", folder, number, "--out", tmp_path)
    assert result.returncode == 0, result.stderr
    assert "failed (collision and destination), ended by a collision" in result.stdout
    assert "gave the same trace" in result.stdout
    assert re.search(r"  collision 0.00 \(violated\), lines [\d.]+, destination [\d.]+ \(violated\)\n", result.stdout)
    with Image.open(tmp_path / f"{number:06d}.gif") as animation:
        store = Store.read(folder)
        duration = store.execution(number).load_trace().duration
        store.close()
        assert animation.n_frames == pytest.approx(duration / 0.1, abs=3)
    with Image.open(tmp_path / f"{number:06d}.png") as picture:
        assert picture.size == (600, 600)


def test_a_replay_that_differs_is_said_to(finished, tmp_path, monkeypatch):
    monkeypatch.setattr(drawing, "MAX_FRAMES", 2)
    folder, _ = finished
    copy = tmp_path / "copy"
    store = Store.read(folder)
    other = Store.create(copy, (folder / "config.yaml").read_text().replace("cruiser", "Swerver"))
    other.add(store.execution(0))
    other.commit()
    other.close()
    store.close()
    result = run("replay", copy, 0)
    digest = re.search(r"--trust (\S+)", result.stderr)[1]  # which no campaign here has made
    result = run("replay", copy, 0, "--trust", digest)
    assert result.returncode == 1
    assert "NOT reproduced: running it again gave a different trace" in result.stderr


def test_violations_fail_a_check_only_when_asked(tmp_path):
    arguments = [*BEGUN, "--ads", "tests.drivers:Swerver", "--budget", "2"]
    assert run(*arguments, "--out", tmp_path / "a").returncode == 0
    assert run(*arguments, "--out", tmp_path / "b", "--fail-on-violation").returncode == 1


@pytest.mark.parametrize("ads", ["tests.drivers:Cruiser", "tests.drivers:make_cruiser", "tests.drivers:Settable"])
def test_a_class_or_function_makes_the_ads(tmp_path, ads):
    result = run(*BEGUN, "--ads", ads, "--budget", 2, "--out", tmp_path / "a")
    assert result.returncode == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["fuzz", "--env", "intersection-strait"], "did you mean 'intersection-straight'?"),
        (["fuzz", "--env", "nowhere/x-v0"], "name the module that does, as in module:nowhere/x-v0)"),
        (["fuzz", "--env", "CartPole-v1"], "cannot be fuzzed"),
        (["fuzz", "--ads", "rules"], "did you mean 'rule'?"),
        (["fuzz", "--env", "intersection"], "did you mean 'intersection-left' or 'intersection-straight'?"),
        (["fuzz", "--ads", "tests.nothing:here"], "looked for in this folder and on PYTHONPATH"),
        (["fuzz", "--ads", "tests/drivers.py"], "in its folder, name the driver in it, such as drivers:MyDriver"),
        (["fuzz", "--ads", "tests/drivers.py:Swerver"], "in the folder of tests/drivers.py, write drivers:Swerver"),
        (["fuzz", "--ads", "tests.drivers:make_nothing"], "has no predict method"),
        (["fuzz", "--ads", "tests.drivers:np.pi"], "cannot be imported"),
        (["import", "tests"], "tests cannot be read: Is a directory: name one of the files in it"),
        (["fuzz", "--method", "unifrom"], "did you mean 'uniform'?"),
        (["fuzz", "--budget", "0"], "neither a number of executions"),
        (["fuzz", "--batch", "0"], "The batch 0"),
        (["fuzz", "--workers", "-1"], "--workers -1 must lie between"),
        (["fuzz", "--seed", "-1"], "The seed -1"),
        (["fuzz", "--config", "papper"], "did you mean 'paper'?"),
        (["fuzz", "--config", "pyproject.toml"], "is not a YAML file"),
        (["fuzz", "--env-config", '{"duration": 3}'], "cannot be read: No such file or directory"),
        (["fuzz", "--ads", "tests.drivers:Unreadable", "--workers", "0", "--unconfined"], "RuntimeError: no predict"),
        (["fuzz", "--resume", "tests"], "is not a run folder"),
        (
            ["fuzz", "--resume", "tests", "--config", "paper"],
            "--config, --spec and --out cannot be given with --resume",
        ),
        (["records", "nowhere"], "is not a run folder"),
        (["replay", "nowhere", "0"], "is not a run folder"),
        (["fuzz", "--env", ":"], "cannot be made"),
        (["fuzz", "--ads", "tests.broken_driver:ads"], "cannot be imported: ZeroDivisionError"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input_is_one_sentence(arguments, message, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    if arguments[0] == "fuzz" and "--resume" not in arguments:
        arguments = [*arguments, "--out", str(tmp_path / "run")]
    assert main(arguments) == 2
    output = capsys.readouterr()
    lines = [line for line in output.err.splitlines() if not line.startswith(("Fuzzing ", "Loading "))]
    assert len(lines) == 1
    assert message in lines[0]
    assert output.out == ""
    assert not (tmp_path / "run").exists()


def test_names_of_files_need_not_be_text(tmp_path, monkeypatch):
    run = stored_run(tmp_path / "run", "ads: constant\nenv: lane-follow\n", 3)
    printed = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(printed, "utf-8"))
    page = tmp_path / "\udcff.html"
    assert main(["report", str(run), "--out", str(page)]) == 0
    sys.stdout.flush()
    assert printed.getvalue() == f"Report: {tmp_path}/\\udcff.html\n".encode()
    assert page.is_file()


@pytest.mark.parametrize(
    "arguments", [["fuzz", "--enw", "x"], ["fuzz", "--budget"], ["fuzz", "--seed", "x"], ["fuss"], []]
)
def test_bad_flags_exit_with_2_and_no_traceback(arguments):
    result = run(*arguments)
    assert result.returncode == 2
    assert "Traceback" not in result.stderr


def test_a_driver_in_the_working_directory_is_found(tmp_path):
    (tmp_path / "own_driver.py").write_text("from tests.drivers import cruiser\n")
    program = Path(sys.executable).with_name("behavexplor")
    command = [program, "evaluate", "--env", "lane-follow", "--ads", "own_driver:cruiser", "--scenarios", "1"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    result = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False)
    assert result.returncode == 0, result.stderr


def test_a_driver_that_cannot_be_loaded_leaves_no_run_behind(tmp_path):
    (tmp_path / "own_driver.py").write_text("import os\nos._exit(3)\n")
    result = run_apart("fuzz", "--ads", "own_driver:driver", "--workers", "1", "--env", "lane-follow", cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.endswith("The ADS cannot be loaded: its process ended with exit code 3\n")
    assert not (tmp_path / "runs").exists()


def test_a_folder_that_is_not_empty_is_kept(tmp_path):
    (tmp_path / "mine").write_text("precious")
    result = run(*FUZZ, "--budget", 2, "--out", tmp_path)
    assert result.returncode == 2
    assert "is not empty" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.parametrize(
    ("driver", "kind", "message", "workers"),
    [
        ("Faulty", "raised", "ZeroDivisionError: no gap to divide by", 2),
        ("Leaver", "exit", "it called sys.exit(0)", 0),
        ("Crashing", "crash", "its process was ended by SIGKILL", 1),
    ],
)
def test_what_an_ads_does_instead_of_driving_is_recorded(driver, kind, message, workers, tmp_path):
    (tmp_path / "limits.yaml").write_text("time_limit: 2\nmemory_limit: 3\n")
    flags = ["--method", "uniform", "--budget", 3, "--workers", workers, "--config", tmp_path / "limits.yaml"]
    result = run(*WITH_WORKERS, *flags, "--ads", f"tests.drivers:{driver}", "--out", tmp_path / "a")
    assert result.returncode == (0 if driver == "Faulty" else 3), result.stderr  # 3: it failed in every execution
    assert "Traceback" not in result.stderr
    assert "Warning" in result.stderr or kind in {"crash", "hang"}
    failed = [record for record in records(tmp_path / "a") if "error" in record]
    assert f"error        {len(failed):5}   executions {failed[0]['id']}" in result.stdout
    for record in failed:
        assert record["violated"] == ["error"]
        assert record["end"] == "error"
        assert record["error"]["kind"] == kind
        assert message in record["error"]["message"]
    again = run("replay", tmp_path / "a", failed[0]["id"])
    assert again.returncode == 0, again.stderr
    assert f"the ADS failed ({kind}): " in again.stdout
    assert "the ADS failed in the same way" in again.stdout


def test_workers_use_one_thread_each(tmp_path):
    flags = ["--ads", "tests.drivers:Threads", "--budget", 4, "--workers", 2]
    result = run(*WITH_WORKERS, *flags, "--out", tmp_path / "a")
    assert result.returncode == 0, result.stderr


def start(folder, *arguments, under=()):
    """A campaign in the background, once it has stored something; `under` another command."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [*under, sys.executable, "-m", "behavexplor", *ENDLESS, "--out", str(folder), *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and process.poll() is None:
        if (folder / "campaign.db").exists() and stored(folder) >= 10:
            return process
        time.sleep(0.05)
    process.kill()
    raise AssertionError(process.communicate()[1])


def stored(folder):
    try:
        store = Store.read(folder)
    except InputError:  # it is being made right now
        return 0
    count = len(store)
    store.close()
    return count


@pytest.mark.parametrize(("number", "workers"), [(signal.SIGINT, "2"), (signal.SIGTERM, "1")])
def test_an_interruption_ends_cleanly_and_can_be_resumed(tmp_path, number, workers):
    folder = tmp_path / "a"
    process = start(folder, "--workers", workers)
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "Traceback" not in err
    counted = int(out.split()[0])
    assert counted == stored(folder) >= 10
    assert f"fuzz --resume {folder}" in err
    resumed = run("fuzz", "--resume", folder, "--workers", 0, "--budget", counted + 5)
    assert resumed.returncode == 0, resumed.stderr
    assert len(records(folder)) == counted + 5


@pytest.mark.parametrize("deleted", ["", "campaign.db"])
def test_a_campaign_whose_run_folder_is_deleted_ends_and_promises_no_results(deleted, tmp_path):
    process = start(tmp_path / "a", "--workers", "1", "--json", str(tmp_path / "found.json"))
    lost = tmp_path / "a" / deleted
    lost.rename(tmp_path / "other")
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (3, "")
    assert err.splitlines()[-1].endswith(f"{lost} was deleted or moved, and with it the results")
    assert "Traceback" not in err


def test_under_nohup_a_campaign_outlives_its_terminal(tmp_path):
    process = start(tmp_path / "a", "--workers", "1", under=["nohup"])
    process.send_signal(signal.SIGHUP)
    count = stored(tmp_path / "a")
    while process.poll() is None and stored(tmp_path / "a") <= count:
        time.sleep(0.05)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert process.returncode == 130


def test_a_terminal_that_is_closed_ends_the_campaign_and_all_its_processes(tmp_path):
    """Its process is the first one of a terminal, which sends SIGHUP to it when it is closed."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ["PYTHONPATH"] = str(ROOT)
        command = ["-m", "behavexplor", *ENDLESS, "--workers", "1", "--out", str(tmp_path / "a")]
        os.execv(sys.executable, [sys.executable, *command])
    deadline = time.monotonic() + 60
    while stored(tmp_path / "a") < 10 and time.monotonic() < deadline:
        time.sleep(0.05)
    descendants = _descendants(pid)
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == -signal.SIGHUP
    while any(Path(f"/proc/{one}").exists() for one in descendants) and time.monotonic() < deadline + 15:
        time.sleep(0.2)
    assert not [one for one in descendants if Path(f"/proc/{one}").exists()]
    count = stored(tmp_path / "a")
    assert run("fuzz", "--resume", tmp_path / "a", "--workers", 0, "--budget", count + 5).returncode == 0
    assert len(records(tmp_path / "a")) == count + 5


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """A campaign that was killed: its folder, what another said that wanted the folder, and its processes."""
    folder = tmp_path_factory.mktemp("killed") / "run"
    process = start(folder, "--workers", "2")
    process.send_signal(signal.SIGSTOP)  # or it might be done before the other has begun
    refused = run("fuzz", "--resume", folder)
    descendants = _descendants(process.pid)
    process.kill()
    process.communicate()
    return folder, refused, descendants


def _descendants(pid):
    listed = subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True, check=False).stdout.split()
    return [*listed, *(grandchild for child in listed for grandchild in _descendants(child))]


def test_a_run_folder_belongs_to_one_campaign_at_a_time(killed):
    _, refused, _ = killed
    assert refused.returncode == 2
    assert "is in use by another command" in refused.stderr


def test_workers_end_with_the_campaign(killed):
    _, _, descendants = killed
    assert len(descendants) >= 3  # two workers, and the process that started them
    deadline = time.monotonic() + 15
    while any(Path(f"/proc/{pid}").exists() for pid in descendants) and time.monotonic() < deadline:
        time.sleep(0.2)
    assert not [pid for pid in descendants if Path(f"/proc/{pid}").exists()]


def test_after_sigkill_nothing_counted_is_lost_and_the_campaign_goes_on(killed, tmp_path):
    folder, *_ = killed
    kept = records(folder)
    assert [record["id"] for record in kept] == list(range(len(kept)))
    total = len(kept) + 10
    assert run("fuzz", "--resume", folder, "--workers", 0, "--budget", total).returncode == 0
    whole = tmp_path / "whole"
    assert run(*FUZZ, "--budget", total, "--out", whole).returncode == 0
    assert records(folder) == records(whole)


def test_a_smaller_budget_is_refused_on_resuming(finished):
    folder, _ = finished
    result = run("fuzz", "--resume", folder, "--budget", 5)
    assert result.returncode == 2
    assert "--budget 5 is less than the 12 executions" in result.stderr
    assert "budget: '12'" in (folder / "config.yaml").read_text()


def test_a_smaller_budget_ends_a_run_earlier_and_is_not_kept(tmp_path):
    folder = tmp_path / "a"
    assert run(*FUZZ, "--budget", 4, "--out", folder).returncode == 0
    config = folder / "config.yaml"
    config.write_text(config.read_text().replace("budget: '4'", "budget: '9'"))
    earlier = run("fuzz", "--resume", folder, "--budget", 6, "--workers", 0)
    assert earlier.stdout.startswith("6 executions")
    assert "budget: '9'" in config.read_text()
    assert run("fuzz", "--resume", folder, "--workers", 0).stdout.startswith("9 executions")
    assert run("fuzz", "--resume", folder, "--budget", 10, "--workers", 0).stdout.startswith("10 executions")
    assert "budget: '10'" in config.read_text()
    again = run("fuzz", "--resume", folder, "--workers", 0)
    assert again.returncode == 0
    assert "The run was already complete: a larger --budget extends it" in again.stderr


@pytest.mark.parametrize("text", ["{{{", "", "[1, 2]", "env: 3"])
def test_a_damaged_configuration_is_one_sentence(finished, tmp_path, text):
    folder, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    (copy / "config.yaml").write_text(text)
    for arguments in (["replay", copy, 0], ["fuzz", "--resume", copy]):
        result = run(*arguments)
        assert "Traceback" not in result.stderr
        assert result.returncode == 2


def test_only_the_budget_changes_on_resuming(finished):
    folder, _ = finished
    result = run("fuzz", "--resume", folder, "--seed", 6)
    assert result.returncode == 2
    assert "--seed cannot be changed with --resume: the run has 5" in result.stderr


def test_help_is_quick_and_says_what_matters():
    result = run("fuzz", "--help")
    assert result.returncode == 0
    for flag in ("env", "ads", "method", "config", "budget", "seed", "workers", "batch", "out", "resume", "quiet"):
        assert f"--{flag}" in result.stdout
    words = " ".join(result.stdout.replace("│", " ").split())
    assert "lane-follow; one of highway-env's own, such as highway-fast-v0 (docs/highway-policies.md)" in words


def test_records_can_be_cut_off_by_head(finished):
    folder, _ = finished
    command = f"{sys.executable} -m behavexplor records {folder} | head -n 1"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=60, check=False)
    assert result.stderr == ""
    assert json.loads(result.stdout)["id"] == 0


def test_the_version_is_told(capsys):
    assert main(["--version"]) == 0
    assert re.fullmatch(r"behavexplor \d+\.\d+\.\d+\S*\n", capsys.readouterr().out)


def test_the_words_of_a_bug_do_not_reach_the_terminal_as_they_are(monkeypatch, capsys):
    ours = {}
    exec("def broken() -> int:\n    raise RuntimeError('clears \x1b[2J')\n", ours)
    monkeypatch.setattr(commands, "_command", lambda _: ours["broken"])
    assert main(["records"]) == INTERNAL_ERROR
    printed = capsys.readouterr().err
    assert "RuntimeError: clears \\x1b[2J" in printed
    assert all(line.isprintable() for line in printed.splitlines())
    assert "This is a bug in behavexplor, or in a search method" in printed


class Absent(Uniform):
    """A search method that cannot be made."""

    def __init__(self, logical, seed, options):
        raise ValueError("no seed")


def test_an_error_in_code_of_the_user_is_said_to_be_there(tmp_path, capsys):
    assert main([*FUZZ, "--method", f"{__name__}:Absent", "--out", str(tmp_path / "a")]) == BAD_INPUT
    printed = capsys.readouterr().err
    assert "ValueError: no seed" in printed
    assert "The error is in test_commands.py, line " in printed


def test_an_execution_without_an_avoidance_says_why(finished):
    folder, _ = finished
    hit = next(record["id"] for record in records(folder) if "collision" in record["violated"])
    passed = next(record["id"] for record in records(folder) if not record["violated"])
    assert "has not been examined yet" in run("replay", folder, hit, "--avoided").stderr
    assert "has no collision that could be avoided" in run("replay", folder, passed, "--avoided").stderr


def test_a_full_disk_is_no_bad_input_and_its_file_is_named(monkeypatch, capsys):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device", "model.pt")

    monkeypatch.setattr("behavexplor.commands.status.summarize", full)
    assert main(["status", "run"]) == EXECUTION_FAILED
    assert "No space left on device: 'model.pt'" in capsys.readouterr().err


def test_a_replay_whose_worker_cannot_begin_is_said_in_a_sentence(finished, tmp_path, monkeypatch, capsys):
    def fail(*_):
        raise RuntimeError("no worker could be started")

    monkeypatch.setattr("behavexplor.commands.replay.start_executor", fail)
    assert main(["replay", str(finished[0]), "0", "--out", str(tmp_path)]) == EXECUTION_FAILED
    assert ": The execution could not be repeated: no worker could be started" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ExecutionError("The campaign can no longer write to disk"), ": The campaign can no longer write to disk"),
        (RuntimeError("a worker ended"), ": A scenario could not be executed: a worker ended"),
    ],
)
def test_an_evaluation_says_what_has_failed(error, said, monkeypatch, capsys):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("behavexplor.commands.evaluate._evaluations", fail)
    assert main(["evaluate", "--env", "lane-follow", "--ads", "constant"]) == EXECUTION_FAILED
    assert said in capsys.readouterr().err


def test_rates_that_differ_are_named_as_the_table_shows_them(capsys):
    """A missed destination is the reverse of an arrival, which has the row."""
    always, never = (Evaluation(1000, {"arrived": n, "collision": 0, "destination": 1000 - n}) for n in (1000, 0))
    assert "(Fisher's exact test, 1 %): arrived. " in _gap(always, never)


def test_output_that_cannot_be_written_is_said_in_a_sentence(tmp_path):
    folder = stored_run(tmp_path / "run", "ads: constant\nenv: lane-follow\n", 3)
    command = [sys.executable, "-m", "behavexplor", "records", str(folder)]
    with Path("/dev/full").open("w") as full:
        result = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert result.returncode == EXECUTION_FAILED
    assert result.stderr.endswith(": The output cannot be written: No space left on device\n")
    assert "Traceback" not in result.stderr
    closed = subprocess.run(["sh", "-c", '"$@" >&-', "sh", *command], capture_output=True, text=True, check=False)
    assert (closed.returncode, closed.stderr) == (OK, "")
