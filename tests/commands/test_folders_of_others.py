"""Folders that another user has made: what they name is not run without a word of this user. Own ones need none."""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from behavexplor import open_run
from behavexplor.ads.sb3.archive import read_archive
from behavexplor.ads.sb3.building import build_trusted
from behavexplor.ads.sb3.description import named_env
from behavexplor.ads.sb3.policy import load_policy
from behavexplor.campaign.config import StoredConfig, stored_config
from behavexplor.campaign.folder_format import CONFIG
from behavexplor.campaign.provenance import Consent, accepted, list_path
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.data.drawn_scenario import Setup, config_text
from behavexplor.data.target import Target
from behavexplor.envs.making import make_recorded
from behavexplor.errors import InputError
from behavexplor.execution.start import logical_of_target, start_executor
from behavexplor.repair.cases import CASES, SUITE, TEST
from behavexplor.repair.retraining_rounds import RetrainingConfig
from behavexplor.report import drawing
from tests.ads.sb3.models import make_model
from tests.campaign.test_store import execution
from tests.confining import confines

ROOT = Path(__file__).parents[2]
SEED = 1  # its first execution with a constant driver is a collision
EVIL = "from pathlib import Path\nPath(r'{canary}').write_text('was here')\n"
pytestmark = pytest.mark.filterwarnings("default:The driver or other code is not")
CODE = {
    "ads": {"ads": "evil:Driver"},
    "env": {"env": "evil:evil/x-v0"},
    "plugin": {"env": "evil/x-v0"},
    "method": {"method": "evil:Search"},
    "specs": {"specs": ["evil:spec"]},
    "env_config": {"env": "highway-fast-v0", "env_config": {"other_vehicles_type": "evil.Vehicle"}},
    "unconfined": {"ads": "evil:Driver", "unconfined": True, "trust": [f"sha256:{'0' * 64}"]},
}
DRIVING = {"ads", "env", "plugin", "env_config", "unconfined"}
COMMANDS = {  # what each of them would run
    "replay": (["RUN", "0", "--out", "OUT"], DRIVING),
    "replay --avoided": (["RUN", "0", "--out", "OUT", "--avoided"], DRIVING),
    "export": (["RUN", "0", "--out", "OUT"], DRIVING - {"ads", "unconfined"}),
    "export --format csv": (["RUN", "0", "--out", "OUT", "--format", "csv"], set()),
    "triage": (["RUN", "--workers", "0"], DRIVING | {"specs"}),
    "minimize": (["RUN", "0", "--workers", "0"], DRIVING | {"specs"}),
    "suite": (["RUN", "--out", "OUT", "--workers", "0"], DRIVING | {"specs"}),
    "fuzz": (["--resume", "RUN", "--workers", "1"], set(CODE)),
    "report": (["RUN"], set()),
    "records": (["RUN"], set()),
    "status": (["RUN"], set()),
}


@pytest.fixture
def theirs(tmp_path, monkeypatch):
    """Another user's folder, in which this user stands. Its module leaves a canary if it is imported."""
    folder = tmp_path / "theirs"
    (folder / "evil").mkdir(parents=True)
    (folder / "evil" / "__init__.py").write_text(EVIL.format(canary=folder / "canary"))
    (folder / "evil-1.dist-info").mkdir()
    (folder / "evil-1.dist-info" / "METADATA").write_text("Name: evil\nVersion: 1\n")
    (folder / "evil-1.dist-info" / "entry_points.txt").write_text("[behavexplor.environments]\nevil = evil\n")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", [*sys.path, str(folder)])  # for workers of this process, which began elsewhere
    monkeypatch.setattr(drawing, "MAX_FRAMES", 2)
    return folder


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run of a shipped driver; its first execution is a failure."""
    folder = tmp_path_factory.mktemp("runs") / "made"
    flags = ["--method", "uniform", "--budget", "1", "--seed", str(SEED), "--workers", "0", "--quiet"]
    assert main(["fuzz", "--ads", "constant", *flags, "--out", str(folder)]) == OK
    assert open_run(folder).records[0].failed
    return folder


@pytest.fixture
def a_run(made):
    """What makes a run folder as another machine would make it, with other values in its configuration."""

    def copied(folder, **values):
        shutil.copytree(made, folder)
        config = replace(stored_config(made).unverified, **values)
        (folder / CONFIG).write_text(config.to_yaml())
        return folder

    return copied


def files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts}


def one_sentence(capsys):
    """The only line on stderr."""
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    return said


@pytest.mark.parametrize(
    ("command", "key"),
    [(name, key) for name, (_, running) in COMMANDS.items() for key in CODE if key in running or not running],
)
def test_no_command_runs_what_only_a_folder_names(command, key, theirs, a_run, tmp_path, capsys):
    arguments, running = COMMANDS[command]
    a_run(theirs / "run", **CODE[key])
    before = files(theirs)
    places = {"RUN": str(theirs / "run"), "OUT": str(tmp_path / "out")}
    code = main([command.split()[0], *(places.get(one, one) for one in arguments)])
    assert not (theirs / "canary").exists()
    if key not in running:
        assert code == OK
        return
    assert code == BAD_INPUT
    assert files(theirs) == before
    assert not (tmp_path / "out").exists()
    said = one_sentence(capsys)
    assert re.search(r"run/config.yaml would have .*evil.* run.*add --trust sha256:[0-9a-f]{64} ", said), said
    if key != "env_config":
        assert str(theirs / "evil" / "__init__.py") in said


def test_the_flag_that_is_named_runs_it(theirs, a_run, capsys):
    replay = ["replay", str(a_run(theirs / "run", **CODE["unconfined"])), "0"]
    assert main(replay) == BAD_INPUT
    digest = re.search(r"--trust (\S+)", one_sentence(capsys))[1]
    assert main([*replay, "--trust", digest]) == BAD_INPUT  # it has no Driver
    assert (theirs / "canary").exists()


def test_no_library_is_loaded_from_the_folder_in_which_a_user_stands(theirs, a_run, tmp_path):
    a_run(theirs / "run")
    for library in ("tyro", "yaml", "highway_env", "numpy", "random", "socket"):
        (theirs / f"{library}.py").write_text(EVIL.format(canary=theirs / "canary"))
    (tmp_path / "script.py").write_text("import sys\nfrom behavexplor.commands import main\nsys.exit(main())\n")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    for arguments in (["status", "run"], ["replay", "run", "0", "--out", str(tmp_path / "out")]):
        command = [sys.executable, str(tmp_path / "script.py"), *arguments]
        subprocess.run(command, cwd=theirs, env=environment, check=True, capture_output=True, timeout=120)
    assert not (theirs / "canary").exists()


def test_code_that_a_command_does_not_run_is_not_asked_for(theirs, a_run, tmp_path):
    a_run(theirs / "run", ads="evil:Driver", method="evil:Search", specs=("evil:spec",))
    assert main(["export", str(theirs / "run"), "0", "--out", str(tmp_path / "out")]) == OK
    a_run(theirs / "other", method="evil:Search", specs=("evil:spec",))
    assert main(["replay", str(theirs / "other"), "0", "--out", str(tmp_path / "out")]) == OK
    assert not (theirs / "canary").exists()


@pytest.mark.parametrize("key", ["ads", "env", "method", "specs"])
def test_the_same_holds_in_python(key, theirs, a_run):
    run = open_run(a_run(theirs / "run", **CODE[key]))
    calls = [run.resume]
    calls += [] if key == "method" else [lambda: run.triage(workers=0), lambda: run.minimize(workers=0)]
    calls += [lambda: run.repeat(0)] if key in DRIVING else []
    for call in calls:
        with pytest.raises(InputError, match="if you trust it"):
            call()
    assert not (theirs / "canary").exists()


@pytest.mark.parametrize("values", [CODE["env"], {"method": "evil:Search", "pool": "found"}, CODE["env_config"]])
def test_a_retraining_runs_none(values, theirs, capsys):
    (theirs / "retraining.yaml").write_text(
        RetrainingConfig(**{"env": "lane-follow", "policy": "learned:lane-follow", **values}).to_yaml()
    )
    assert main(["retrain", "--resume", str(theirs)]) == BAD_INPUT
    assert "would have" in one_sentence(capsys)
    assert not (theirs / "canary").exists()


@pytest.mark.parametrize("key", ["driver", "env", "specs", "env_config"])
def test_a_suite_runs_none(key, theirs, capsys):
    values = {"env": "lane-follow", "driver": "constant", **CODE.get(key, {"driver": "evil:Driver"})}
    (theirs / "suite" / CASES).mkdir(parents=True)
    (theirs / "suite" / SUITE).write_text(yaml.safe_dump({"format": 1, **values}))
    case = {"words": "w", "class_id": "R1/a", "run": "r", "execution": 0, "holds": ["collision"]}
    case["scenario"] = execution(0).scenario.to_dict()
    (theirs / "suite" / CASES / "a.yaml").write_text(yaml.safe_dump(case))
    assert main(["check", str(theirs / "suite"), "--workers", "0"]) == BAD_INPUT
    assert "would have" in one_sentence(capsys)
    if key == "specs":
        assert main(["check", str(theirs / "suite"), "--ads", "idm", "--workers", "0"]) == BAD_INPUT
    assert not (theirs / "canary").exists()


def test_what_a_run_says_is_only_shown_and_compared():
    """A new reader of run folders that executes something calls `accepted`; one that shows something is added here."""
    package = ROOT / "behavexplor"
    readers = {
        path.relative_to(package).as_posix() for path in package.rglob("*.py") if ".unverified" in path.read_text()
    }
    assert readers == {
        "api/run.py",
        "bench/runs.py",
        "campaign/opening.py",
        "campaign/provenance.py",
        "campaign/run_summary.py",
        "campaign/same_driver.py",
        "commands/export.py",
        "commands/fuzz.py",
        "report/reading.py",
    }
    assert not hasattr(StoredConfig, "target")


def test_a_recorded_scenario_brings_none(theirs):
    for env, config in (("evil:x-v0", {}), ("evil/x-v0", {}), ("highway-v0", {"other_vehicles_type": "evil.V"})):
        with pytest.raises(InputError, match="which its run does not use"):
            make_recorded(Setup(env, config_text(config), "default", "1.12"))
    assert not (theirs / "canary").exists()


@pytest.mark.parametrize("command", ["fuzz", "evaluate", "compare", "retrain"])
def test_the_files_beside_a_policy_bring_none(command, theirs, capsys):
    (theirs / "model.zip").write_bytes(b"")
    (theirs / "model.yaml").write_text("env: evil:evil/x-v0\n")
    policy = {"compare": ["model.zip", "idm"], "retrain": ["model.zip"]}.get(command, ["--ads", "model.zip"])
    assert main([command, *policy]) == BAD_INPUT
    assert "add --env evil:evil/x-v0" in one_sentence(capsys)
    assert named_env("evil:evil/x-v0", "model.zip") == "evil:evil/x-v0"  # the user's own word
    assert not (theirs / "canary").exists()


def test_traffic_that_the_files_beside_a_policy_name_is_not_loaded(theirs, capsys):
    make_model("PPO").save(theirs / "model")
    (theirs / "model.yaml").write_text("env: highway-fast-v0\nconfig: {other_vehicles_type: evil.Vehicle}\n")
    for arguments in (["evaluate", "--workers", "1", "--ads", "model.zip"], ["retrain", "model.zip"]):
        assert main(arguments) == BAD_INPUT
        assert "evil.Vehicle for the traffic, which was not loaded" in capsys.readouterr().err
    assert not (theirs / "canary").exists()


def test_a_pickle_is_not_run_because_its_folder_trusts_it(theirs, a_run, capsys):
    model = make_model("PPO")
    model.policy_class = Touching(str(theirs / "canary"), model.policy_class)
    model.save(theirs / "model")
    (theirs / "canary").unlink(missing_ok=True)
    digest = read_archive(theirs / "model.zip").digest
    run = a_run(theirs / "run", ads=str(theirs / "model.zip"), trust=(digest,), unconfined=True)
    resume = ["fuzz", "--resume", str(run), "--budget", "2", "--workers", "1"]
    for command, said in ((["replay", str(run), "0"], f"add --trust {digest}"), (resume, "has changed: model.zip")):
        assert main(command) == BAD_INPUT
        assert said in capsys.readouterr().err
        assert not (theirs / "canary").exists()
    main(["replay", str(run), "0", "--trust", digest, "--unconfined"])
    assert (theirs / "canary").exists()  # where the user says so
    assert accepted(stored_config(run), Consent((digest,), unconfined=True)).target.trust == (digest,)


class Touching:
    """Touches a file when it is unpickled."""

    def __init__(self, path, real):
        self.path, self.real = path, real

    def __reduce__(self):
        return Touching._touch, (self.path, self.real)

    @staticmethod
    def _touch(path, real):
        Path(path).touch()
        return real

    def __call__(self, *values, **named):
        return self.real(*values, **named)


def test_what_a_folder_says_of_trust_and_confinement_does_not_count(a_run, tmp_path):
    model = tmp_path / "model.zip"
    model.write_bytes(b"")
    said = {"ads": str(model), "trust": (f"sha256:{'0' * 64}",), "unconfined": True}
    target = accepted(stored_config(a_run(tmp_path / "run", **said))).target
    assert (target.trust, target.unconfined) == ((), False)
    target = accepted(stored_config(tmp_path / "run"), Consent(unconfined=True)).target
    assert (target.trust, target.unconfined) == ((), True)


def test_a_file_that_is_typed_may_name_code_but_not_trust_it(theirs, capsys):
    digest = f"sha256:{'1' * 64}"
    for said, flag in ((f"trust: ['{digest}']", f"--trust {digest}"), ("unconfined: true", "--unconfined")):
        (theirs / "config.yaml").write_text(f"ads: constant\n{said}\n")
        assert main(["fuzz", "--config", "config.yaml"]) == BAD_INPUT
        assert f"counts only on the command line: add {flag}" in one_sentence(capsys)
        (theirs / "e.yaml").write_text(f"methods: {{a: {{method: uniform}}}}\nads: [constant]\n{said}\n")
        assert main(["bench", "e.yaml", "--out", str(theirs / "out")]) == BAD_INPUT
        assert f"counts only on the command line: add {flag}" in one_sentence(capsys)


MINE = "from tests.drivers import Swerver\nclass Mine(Swerver):\n    pass\n"


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A run of this user's own driver, beside the driver. Its command line has let it be unconfined."""
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.setattr(drawing, "MAX_FRAMES", 2)
    monkeypatch.syspath_prepend(tmp_path)
    flags = ["--unconfined", "--method", "uniform", "--budget", "2", "--workers", "1", "--quiet"]
    assert main(["fuzz", "--ads", "mine:Mine", *flags, "--out", str(tmp_path / "run")]) == OK
    return tmp_path


def test_an_own_run_needs_no_flag_also_when_it_is_moved(own, tmp_path):
    moved = shutil.copytree(own / "run", tmp_path / "elsewhere" / "run")
    shutil.rmtree(own / "run")
    assert accepted(stored_config(moved)).target.unconfined
    assert main(["replay", str(moved), "0", "--out", str(tmp_path / "out")]) == OK
    assert main(["fuzz", "--resume", str(moved), "--budget", "3", "--workers", "1", "--quiet"]) == OK


def test_an_own_run_whose_driver_has_changed_needs_a_word_and_does_not_go_on(own, tmp_path, capsys):
    (own / "mine.py").write_text(MINE.replace("pass", "x = 1"))
    replay = ["replay", str(own / "run"), "0", "--out", str(tmp_path / "out")]
    resume = ["fuzz", "--resume", str(own / "run"), "--budget", "3", "--workers", "1", "--quiet"]
    capsys.readouterr()
    assert main(resume) == BAD_INPUT
    assert "has changed: module mine (SHA-256" in one_sentence(capsys)
    assert main(replay) == BAD_INPUT
    digest = re.search(r"mine.py run.*add --trust (sha256:\w{64}).*since the run began", one_sentence(capsys))[1]
    assert main([*replay, "--trust", digest]) == OK
    assert main(replay) == BAD_INPUT  # one word, for one command
    capsys.readouterr()
    assert main([*resume, "--ads", "mine:Mine"]) == BAD_INPUT  # the driver's name is a word, too, but no way to mix two
    assert "has changed: module mine (SHA-256" in one_sentence(capsys)
    (own / "mine.py").write_text(MINE)
    assert main(resume) == OK
    assert main(replay) == OK
    assert not stored_config(own / "run").unverified.trust
    assert open_run(own / "run").repeat(0).reproduced


def test_an_own_suite_needs_no_flag_and_a_copy_on_another_machine_does(own, tmp_path, monkeypatch, capsys):
    (own / "judges.py").write_text("def calm(trace):\n    return 1.0\n")
    flags = ["--unconfined", "--method", "uniform", "--budget", "12", "--workers", "1", "--quiet"]
    again = str(own / "again")
    assert main(["fuzz", "--ads", "mine:Mine", "--spec", "judges:calm", *flags, "--out", again]) == OK
    assert main(["suite", again, "--out", str(own / "suite"), "--workers", "1", "--quiet"]) == OK
    check = ["check", str(own / "suite"), "--quiet", "--workers", "1"]
    assert main(check) != BAD_INPUT
    (own / "mine.py").write_text(MINE.replace("Swerver", "Cruiser"))  # to make it better is what suites are for
    assert main(check) == BAD_INPUT
    assert "or name it by --ads" in capsys.readouterr().err
    assert main([*check, "--ads", "mine:Mine"]) != BAD_INPUT
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another machine"))
    capsys.readouterr()
    assert main([*check, "--ads", "mine:Mine"]) == BAD_INPUT
    said = one_sentence(capsys)
    assert "specs judges:calm" in said
    assert "mine" not in said.partition(" run,")[0].replace("mine.py", "mine")
    digest = re.search(r"--trust (sha256:\w{64})", said)[1]
    assert main([*check, "--ads", "mine:Mine", "--trust", digest]) != BAD_INPUT
    assert "opened_driver(SUITE, os.environ.get" in (own / "suite" / TEST).read_text()


def test_the_bytes_that_are_trusted_are_those_that_are_loaded(tmp_path):
    make_model("PPO").save(tmp_path / "model")
    archive = read_archive(tmp_path / "model.zip")
    (tmp_path / "model.zip").write_bytes(b"swapped")
    assert type(build_trusted(archive)).__name__ == "ActorCriticPolicy"
    with pytest.raises(InputError):
        load_policy(tmp_path / "model.zip", trust=[archive.digest])


@pytest.mark.skipif(not confines(), reason="this system cannot confine a process")
def test_a_confined_driver_cannot_make_a_folder_this_machines(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.syspath_prepend(tmp_path)
    path = list_path()
    path.parent.mkdir(parents=True)
    path.touch(mode=0o600)
    (tmp_path / "forger.py").write_text(f"open({str(path)!r}, 'a').write('x')\n")
    (tmp_path / "founder.py").write_text(f"from pathlib import Path\nPath({str(path)!r} + '2').touch()\n")
    for driver in ("forger:Driver", "founder:Driver"):
        executor, refused = (
            start_executor(Target("lane-follow", driver), 1),
            pytest.raises(InputError, match="Permission"),
        )
        with executor as workers, refused:
            logical_of_target(workers, "lane-follow")
    assert path.read_text() == ""
    assert [one.name for one in path.parent.iterdir()] == [path.name]
