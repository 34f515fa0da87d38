"""Results in words, and flags that two commands share."""

import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import pytest

from behavexplor.campaign.config import campaign_config, stored_config
from behavexplor.commands import BAD_INPUT, CHECK_FAILED, EXECUTION_FAILED, OK, main
from behavexplor.commands.arguments import COMMANDS, SEVERAL_TIMES
from behavexplor.commands.check import result
from behavexplor.commands.outputs import CaseResult, write_junit
from behavexplor.envs.making import environment_id
from behavexplor.errors import InputError
from behavexplor.execution.simulation import Simulation
from behavexplor.repair.cases import Case, Suite
from behavexplor.repair.checking import CheckedCase


@pytest.mark.parametrize(
    ("failed", "count", "said"),
    [
        (0, 1, "The only scenario passes"),
        (1, 1, "The only scenario fails"),
        (0, 3, "All 3 scenarios pass"),
        (1, 3, "1 of 3 scenarios fails"),
        (2, 3, "2 of 3 scenarios fail"),
    ],
)
def test_one_scenario_is_not_many(failed, count, said):
    assert result(failed, count) == said


def test_compare_leaves_confirmation_out_as_fuzz_does(tmp_path, monkeypatch, capsys):
    def refuse(*_):
        raise AssertionError("highway-env was asked")

    monkeypatch.setattr(Simulation, "run", refuse)
    drivers = ["constant:FASTER", "constant:IDLE"]
    flags = ["--env", "merge-v0", "--scenarios", "2", "--workers", "0", "--quiet", "--no-confirm"]
    assert main(["compare", *drivers, *flags, "--out", str(tmp_path / "out")]) == OK
    assert "2 scenarios of merge-v0" in capsys.readouterr().out
    assert not stored_config(tmp_path / "out" / "second").unverified.confirm


JUDGING = [["check", "suite"], ["evaluate", "--below", "0.1"], ["fuzz"], ["compare", "idm", "idm", "--margin", "0.1"]]


@pytest.mark.parametrize("flag", ["--json", "--junit"])
@pytest.mark.parametrize("command", JUDGING)
def test_files_are_looked_at_before_the_work(tmp_path, monkeypatch, capsys, command, flag):
    monkeypatch.setattr(Suite, "read", lambda _: Suite(env="lane-change", driver="idm"))
    nowhere = [
        (tmp_path, "is a folder: name a file"),
        (tmp_path / "no" / "x", f"no folder {tmp_path / 'no'}"),
        (tmp_path / ("x" * 250), "File name too long"),  # with what is added until the file is complete
        (Path("/proc/x"), "/proc/x cannot be written"),  # where even root creates no files
    ]
    for path, said in nowhere:
        assert main([*command, flag, str(path)]) == BAD_INPUT
        assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", JUDGING)
def test_test_cases_have_the_time_that_is_known_and_the_file_of_their_scenario(tmp_path, finished, command, capsys):
    flags = ["--workers", "0", "--quiet", "--junit", str(tmp_path / "x.xml")]
    if command[0] == "check":
        assert main(["suite", str(finished), "--out", str(tmp_path / "suite"), "--workers", "0"]) == OK
        command = ["check", str(tmp_path / "suite")]
    elif command[0] == "fuzz":
        command = ["fuzz", "--resume", str(finished)]
    else:
        command = [*command, "--env", "lane-change", "--scenarios", "2"]
    if command[0] == "compare":
        command += ["--out", str(tmp_path / "two")]
    main([*command, *flags])
    suite = ET.parse(tmp_path / "x.xml").getroot().find("testsuite")
    cases = suite.findall("testcase")
    times = {case.get("time") for case in cases}
    assert float(suite.get("time")) > 0.0
    assert times == ({suite.get("time")} if len(cases) == 1 else {None})
    files = [case.get("file") for case in cases]
    assert all(Path(file).is_file() for file in files) if command[0] in ("check", "fuzz") else set(files) == {None}


@pytest.mark.parametrize("command", [["evaluate"], ["compare", "idm", "idm"]])
def test_a_verdict_needs_a_threshold(command, tmp_path, capsys):
    assert main([*command, "--junit", str(tmp_path / "x.xml")]) == BAD_INPUT
    assert "give one with --" in capsys.readouterr().err


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run with a failure."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    flags = ["--ads", "constant:2,0.1", "--env", "lane-change", "--budget", "2", "--workers", "0", "--quiet"]
    assert main(["fuzz", *flags, "--out", str(folder)]) == OK
    return folder


@pytest.mark.parametrize(
    "command",
    [
        ["fuzz", "--env", "lane-change"],
        ["evaluate", "--env", "lane-change"],
        ["compare", "idm", "idm", "--env", "lane-change"],
        ["train", "--env", "lane-change"],
        ["demo"],
        ["suite", "RUN"],
        ["export", "RUN"],
        ["replay", "RUN", "0"],
        ["bench", "quick"],
    ],
)
@pytest.mark.parametrize("place", ["file", "file/in/it"])
def test_a_file_where_a_folder_is_meant_is_named(tmp_path, finished, command, place, capsys):
    (tmp_path / "file").write_text("kept")
    words = [str(finished) if word == "RUN" else word for word in command]
    assert main([*words, "--out", str(tmp_path / place)]) == BAD_INPUT
    said = capsys.readouterr().err
    assert f"{tmp_path / 'file'} is a file: name a folder" in said
    assert "Errno" not in said
    assert (tmp_path / "file").read_text() == "kept"


def test_a_link_to_nothing_where_a_folder_is_meant_is_named(tmp_path, capsys):
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    assert main(["fuzz", "--env", "lane-change", "--out", str(tmp_path / "link")]) == BAD_INPUT
    assert "link is a symbolic link to nothing: name a folder" in capsys.readouterr().err


def test_weights_alone_are_not_trained_further(tmp_path, capsys):
    (tmp_path / "weights.pth").touch()
    assert main(["retrain", str(tmp_path / "weights.pth"), "--env", "highway-fast-v0"]) == BAD_INPUT
    assert "weights.pth holds weights alone, without what trained them: retrain" in capsys.readouterr().err


def test_a_list_where_a_configuration_is_meant_is_named(tmp_path, capsys):
    (tmp_path / "env.yaml").write_text("- lanes_count: 3\n")
    for command in (["fuzz"], ["inspect", "learned:lane-change"]):
        assert main([*command, "--env-config", str(tmp_path / "env.yaml")]) == BAD_INPUT
        assert "env.yaml must contain keys and values, such as `lanes_count: 3`" in capsys.readouterr().err


@pytest.mark.parametrize("value", ["", "5", "my:spec"])
def test_specs_in_a_file_are_a_list(tmp_path, capsys, value):
    (tmp_path / "file.yaml").write_text(f"specs: {value}\n")
    assert main(["fuzz", "--config", str(tmp_path / "file.yaml"), "--spec", "my:other"]) == BAD_INPUT
    assert "specs of the configuration: Input should be a list, got" in capsys.readouterr().err


def test_without_docstrings_commands_run_and_have_no_help(tmp_path):
    told = subprocess.run(
        [sys.executable, "-OO", "-m", "behavexplor", "fuzz", "--help"], capture_output=True, text=True, check=False
    )
    assert told.returncode == OK, told.stderr
    assert "--budget N|TIME" in told.stdout


def test_a_driver_that_raises_a_ctrl_c_leaves_no_traceback(tmp_path, capfd):
    flags = ["--budget", "2", "--workers", "1", "--out", str(tmp_path / "run")]
    assert main(["fuzz", "--ads", "tests.faults:Interrupting", *flags]) == EXECUTION_FAILED
    said = capfd.readouterr()
    assert "KeyboardInterrupt" in said.out
    assert "Traceback" not in said.err


def test_results_are_shown_before_their_files_are_written(tmp_path, monkeypatch, capsys):
    case = Case(words="", class_id="R2", run="run", execution=7, holds=("lines",), scenario={})
    outcome, file = CheckedCase(case, ("lines",), "Touched a line"), tmp_path / "file"
    monkeypatch.setattr(Suite, "read", lambda _: Suite(env="lane-change", driver="idm", cases=(case,)))
    drive = SimpleNamespace(all_of=lambda _: file.mkdir() or [outcome])  # something takes the place of the file
    monkeypatch.setattr("behavexplor.commands.check.opened_driver", lambda *_, **__: nullcontext(drive))
    assert main(["check", "suite", "--junit", str(file)]) == BAD_INPUT
    printed = capsys.readouterr()
    assert "FAIL  R2-7\n      Touched a line" in printed.out
    assert "cannot be written" in printed.err


def test_junit_files_hold_paths_that_are_no_text(tmp_path):
    case = CaseResult("na\udcffme", "fail\x00ed", file=Path("su\udcffte/case.json"))
    write_junit(tmp_path / "file.xml", "check", [case], {"ads": "po\udcfflicy.zip"}, 1.0)
    (suite,) = ET.fromstring((tmp_path / "file.xml").read_text())
    assert suite.find("testcase").get("file") == "su\\udcffte/case.json"
    assert suite.find("testcase/failure").get("message") == "fail\\x00ed"


def test_help_ends_on_the_narrowest_terminal():
    environment = {**os.environ, "COLUMNS": "1"}
    command = [sys.executable, "-m", "behavexplor", "status", "--help"]
    shown = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=True).stdout
    assert "RUN" in shown


def test_a_folder_that_does_not_exist_is_not_said_to_lack_a_file(tmp_path, capsys):
    assert main(["status", str(tmp_path / "nowhere")]) == BAD_INPUT
    said = " ".join(capsys.readouterr().err.split())
    assert "is not a run folder: there is no such folder" in said
    assert "restore" not in said


def test_one_output_is_standard_output_and_nothing_else_is_on_it(monkeypatch, capsys):
    case = Case(words="", class_id="R2", run="run", execution=7, holds=("lines",), scenario={})
    monkeypatch.setattr(Suite, "read", lambda _: Suite(env="lane-change", driver="idm", cases=(case,)))
    drive = SimpleNamespace(all_of=lambda _: [CheckedCase(case, ("lines",), "Touched a line")])
    monkeypatch.setattr("behavexplor.commands.check.opened_driver", lambda *_, **__: nullcontext(drive))
    assert main(["check", "suite", "--json", "-"]) == CHECK_FAILED
    printed = capsys.readouterr()
    assert json.loads(printed.out)["scenarios"][0]["words"] == "Touched a line"
    assert "The only scenario fails" in printed.err
    assert main(["check", "suite", "--junit", "-"]) == CHECK_FAILED
    (suite,) = ET.fromstring(capsys.readouterr().out)
    assert suite.find("testcase/failure").get("message") == "Touched a line"
    assert main(["check", "suite", "--json", "-", "--junit", "-"]) == BAD_INPUT
    assert "cannot both be '-'" in capsys.readouterr().err


def test_unknown_commands_name_the_nearest(capsys):
    assert main(["fuz"]) == BAD_INPUT
    assert "did you mean 'fuzz'?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("fuzz --seed abc", "--seed abc must be a whole number"),
        ("fuzz --workers=1.5", "--workers 1.5 must be a whole number"),
        ("fuzz --fail-above much", "--fail-above much must be a number, such as 0.05"),
        ("compare a b --scenarios 1e3", "--scenarios 1e3 must be a whole number"),
        ("replay run last", "ID last must be a whole number"),
        ("minimize run 1 x", "x must be a whole number"),
        ("fuzz --traffic dense", "--traffic dense must be one of default, wide"),
        ("check s --activation step", "--activation step must be one of elu, gelu, identity"),
        ("fuzz --env-config none.yaml", "none.yaml cannot be read"),
        ("fuzz --seed 1 --seed 2", "--seed is given 2 times: give it once"),
        ("fuzz --env=S1 --method uniform --env S2", "--env is given 2 times"),
        ("fuzz --confirm --no-confirm", "--confirm is given 2 times"),
    ],
)
def test_a_wrong_value_and_a_second_one_are_said_in_a_sentence(arguments, said, capsys):
    assert main(arguments.split()) == BAD_INPUT
    told = capsys.readouterr().err
    assert said in told
    assert len(told.splitlines()) == 1


def test_flags_that_are_lists_are_given_several_times(capsys):
    several = [word for flag in sorted(SEVERAL_TIMES) for word in (flag, "none.a:b", flag, "none.c:d")]
    assert main(["fuzz", "--env", "nowhere", *several]) == BAD_INPUT
    assert "Unknown environment 'nowhere'" in capsys.readouterr().err


def test_what_tyro_says_of_other_mistakes_stays(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["fuzz", "--bugdet", "3"])
    assert ended.value.code == BAD_INPUT
    assert "--budget N|TIME" in capsys.readouterr().err


def test_the_flags_of_fuzz_are_in_groups(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main(["fuzz", "--help"])
    words = [word for line in capsys.readouterr().out.splitlines() for word in line.split() if word.isascii()]
    found = [word for word, after in pairwise(words) if after == "options" or word[:2] == "--"]
    order = ["--config", "--cluster", "driver", "--env", "--ads", "search", "--method", "check", "output", "--junit"]
    assert [word for word in dict.fromkeys(found) if word in order] == order


def test_the_overview_has_every_command_in_a_line(capsys):
    assert main(["--help"]) == OK
    lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines if line.startswith("  ")} == set(COMMANDS)
    assert max(map(len, lines)) < 80
    assert main([]) == BAD_INPUT


def test_the_papers_names_denote_its_scenarios(capsys):
    assert campaign_config({"env": "S4"}).env == "lane-change"
    assert environment_id("S1") == "behavexplor/intersection-straight-v0"
    assert main(["train", "--env", "highway-fast-v0"]) == BAD_INPUT
    assert "HighwayVecEnv" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("prepare", "environment", "said"),
    [
        ("", {"NUMBA_DISABLE_JIT": "1"}, "NUMBA_DISABLE_JIT is set"),
        ("import os; os.rmdir(os.getcwd()); ", {}, "The working directory was deleted"),
    ],
)
def test_a_place_in_which_nothing_runs_is_one_sentence(tmp_path, prepare, environment, said):
    code = f"{prepare}from behavexplor.commands import main; raise SystemExit(main(['status', 'RUN']))"
    environment = {**os.environ, "PYTHONPATH": str(Path.cwd()), **environment}
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path, env=environment
    )
    assert told.returncode == BAD_INPUT
    assert said in told.stderr
    assert "Traceback" not in told.stderr


def test_the_overview_needs_nothing_that_is_slow_to_import():
    code = "import sys; from behavexplor.commands import main; main(['--help']); print('numba' in sys.modules)"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.endswith("False\n")


def test_vector_environments_of_scripted_vehicles_refuse_a_limit_of_steps():
    with pytest.raises(InputError, match="set `duration`"):
        gymnasium.make_vec("behavexplor/lane-change-v0", num_envs=2, max_episode_steps=5)
