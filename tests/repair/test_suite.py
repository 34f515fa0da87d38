"""Regression suites: written from a run, read again, and driven."""

import errno
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import torch
import yaml

from behavexplor.commands import BAD_INPUT, CHECK_FAILED, OK, main
from behavexplor.data.durable import write_durably
from behavexplor.envs.logical_scenarios import LOGICAL_SCENARIOS
from behavexplor.errors import InputError
from behavexplor.repair import cases
from behavexplor.repair.cases import CASES, SUITE, TEST, Case, Suite
from tests.triage.test_triage import fuzz

DRIVER = "tests.drivers:Swerver"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run, and the suite that was made from it."""
    folder = tmp_path_factory.mktemp("suite")
    fuzz(folder / "run", DRIVER, 12)
    assert main(["suite", str(folder / "run"), "--out", str(folder / "suite"), "--workers", "0", "--quiet"]) == OK
    return folder


@pytest.fixture
def suite(made, tmp_path):
    return shutil.copytree(made / "suite", tmp_path / "suite")


def check(folder, *more):
    return main(["check", str(folder), "--workers", "0", "--unconfined", *more])


def test_there_is_one_case_of_each_class_and_each_says_what_happened(made):
    suite = Suite.read(made / "suite")
    assert (suite.env, suite.driver) == ("intersection-straight", DRIVER)
    assert len({case.class_id for case in suite.cases}) == len(suite.cases) > 0
    for case in suite.cases:
        assert case.run == "run"
        assert case.holds == ("collision", "lines", "destination")
        assert case.words


def test_the_driver_it_came_from_fails_everywhere_and_another_may_pass(made, tmp_path, capsys):
    assert check(made / "suite", "--junit", str(tmp_path / "out.xml")) == CHECK_FAILED
    count = len(Suite.read(made / "suite").cases)
    assert f"{count} of {count} scenarios fail" in capsys.readouterr().out
    root = ET.parse(tmp_path / "out.xml").getroot()
    assert root.find("testsuite").get("failures") == str(count)
    assert check(made / "suite", "--ads", "rule:hardened") == OK
    assert f"All {count} scenarios pass" in capsys.readouterr().out


def test_only_what_must_hold_is_checked(suite, capsys):
    for path in (suite / CASES).iterdir():
        values = yaml.safe_load(path.read_text())
        path.write_text(yaml.safe_dump({**values, "holds": ["collision"]}))
    assert check(suite) == CHECK_FAILED
    cases = Suite.read(suite).cases
    collisions = sum(case.class_id.startswith("R1/") for case in cases)
    assert 0 < collisions < len(cases)
    assert f"{collisions} of {len(cases)} scenarios fail" in capsys.readouterr().out


def test_its_tests_run_by_plain_pytest_from_another_folder(made, tmp_path):
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(made / "suite" / TEST)],
        cwd=tmp_path,
        env={"ADS": "rule:hardened", "PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert f"{len(Suite.read(made / 'suite').cases)} passed" in ran.stdout


def test_a_suite_is_not_overwritten(made, capsys):
    arguments = ["suite", str(made / "run"), "--out", str(made / "suite"), "--workers", "0", "--quiet"]
    assert main(arguments) == BAD_INPUT
    assert "is not empty" in capsys.readouterr().err


def test_a_test_file_of_the_user_is_not_overwritten(tmp_path, capsys):
    (tmp_path / TEST).write_text("mine")
    assert main(["suite", str(tmp_path / "run"), "--out", str(tmp_path)]) == BAD_INPUT  # before the run is looked at
    assert "is not empty" in capsys.readouterr().err
    with pytest.raises(InputError, match="is not empty"):
        Suite(env="lane-change", driver="idm").write(tmp_path)
    assert (tmp_path / TEST).read_text() == "mine"


def test_a_suite_that_cannot_be_written_leaves_nothing_behind(made, tmp_path, monkeypatch):
    suite, written = Suite.read(made / "suite"), []

    def write(path, content):
        written.append(path)
        if path.name == TEST:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        write_durably(path, content)

    monkeypatch.setattr(cases, "write_durably", write)
    with pytest.raises(InputError, match="No space left on device"):
        suite.write(tmp_path / "other")
    assert len(written) > 1
    assert list((tmp_path / "other").iterdir()) == []
    monkeypatch.undo()
    suite.write(tmp_path / "other")
    assert Suite.read(tmp_path / "other").cases == suite.cases


def test_a_run_without_failures_makes_no_suite(tmp_path, capsys):
    fuzz(tmp_path / "run", "rule:hardened", 1)
    assert main(["suite", str(tmp_path / "run"), "--out", str(tmp_path / "suite"), "--workers", "0"]) == BAD_INPUT
    assert "nothing to check" in capsys.readouterr().err


def test_runs_of_different_environments_do_not_mix(made, tmp_path, capsys):
    fuzz(tmp_path / "other", DRIVER, 1, "--env", "lane-follow")
    assert main(["suite", str(made / "run"), str(tmp_path / "other"), "--out", str(tmp_path / "suite")]) == BAD_INPUT
    assert "cannot be in one suite: their env is 'lane-follow'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"holds": ["comfort"]}, r"holds: expected one or more of collision, destination, lines, got \['comfort'\]"),
        ({"holds": []}, "holds: expected one or more"),
        ({"scenario": {"functional": "x"}}, "scenario: .*npcs"),
        ({"color": "red"}, "color"),
    ],
)
def test_a_case_that_was_changed_wrongly_is_named(suite, change, message, capsys):
    path = next((suite / CASES).iterdir())
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **change}))
    assert check(suite) == BAD_INPUT
    assert re.search(rf"{path.stem}.*{message}", capsys.readouterr().err)


def test_other_folders_are_refused(tmp_path, suite):
    with pytest.raises(InputError, match=f"has no {SUITE}"):
        Suite.read(tmp_path)
    (suite / SUITE).write_text("format: 7\n")
    with pytest.raises(InputError, match="format 7"):
        Suite.read(suite)


def test_without_cases_there_is_nothing_to_check(suite):
    shutil.rmtree(suite / CASES)
    with pytest.raises(InputError, match="has no scenarios"):
        Suite.read(suite)


def test_a_driver_that_drew_its_actions_draws_them_in_checks_too(suite):
    path = suite / SUITE
    path.write_text(path.read_text() + "stochastic: true\n")
    found = Suite.read(suite)
    assert found.target(DRIVER).stochastic
    assert not found.target("rule").stochastic


def test_weights_that_needed_a_flag_make_a_suite_and_are_compared_and_checked(tmp_path, capsys):
    """Always LANE_LEFT, then SLOWER: the first crashes where the second does not."""
    names = []
    for number, action in enumerate((0, 4)):
        bias = torch.nn.functional.one_hot(torch.tensor(action), 5).float()
        weights = {
            "a.weight": torch.zeros(8, 25),
            "a.bias": torch.zeros(8),
            "b.weight": torch.zeros(5, 8),
            "b.bias": bias,
        }
        torch.save(weights, tmp_path / f"{number}.pth")
        names.append(str(tmp_path / f"{number}.pth"))
    chosen = ["--activation", "relu"]
    place, alone = ["--env", "highway-fast-v0"], ["--workers", "0", "--unconfined", "--quiet"]
    out = ["--out", str(tmp_path / "compared")]
    assert main(["compare", *names, *place, *chosen, "--scenarios", "8", *alone, *out]) == OK
    suite = tmp_path / "suite"
    assert main(["suite", str(tmp_path / "compared" / "first"), "--out", str(suite), *alone]) == OK
    assert Suite.read(suite).activation == "relu"
    assert main(["check", str(suite), *alone]) == CHECK_FAILED
    assert main(["check", str(suite), *alone, "--ads", names[1], *chosen]) == OK
    assert main(["check", str(suite), *alone, "--ads", names[1]]) == BAD_INPUT
    assert "add `activation: relu`" in capsys.readouterr().err


def test_no_name_becomes_code(tmp_path):
    """A run folder of someone else says how its driver is called, and pytest executes the file of a suite."""
    case = {"words": "w", "class_id": "R1", "run": "r", "execution": 0, "holds": ("collision",)}
    case["scenario"] = LOGICAL_SCENARIOS["lane-change"].sample(np.random.default_rng(0)).to_dict()
    texts = set()
    for number, driver in enumerate(("idm", 'x"""\nraise SystemExit\n"""', "\\N{x}", "x\n" * 3)):
        folder = tmp_path / str(number)
        Suite(env="lane-change", driver=driver, cases=(Case(**{**case, "class_id": driver}),)).write(folder)
        texts.add((folder / TEST).read_text())
        assert yaml.safe_load((folder / SUITE).read_text())["driver"] == driver
    assert len(texts) == 1
