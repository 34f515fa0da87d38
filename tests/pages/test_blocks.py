"""Every code block of README, CONTRIBUTING and docs/ runs, or there is a reason why it does not."""

import re
import shutil
import sys
import tomllib
import warnings
from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
from types import ModuleType

import gymnasium
import pytest
import torch
import yaml
from stable_baselines3 import PPO

import behavexplor.ads.learned
from behavexplor import open_run
from behavexplor.ads.sb3.description import describe
from behavexplor.api.evaluating import listed
from behavexplor.bench.experiment import read_experiment
from behavexplor.commands import CHECK_FAILED, OK, UNDECIDED, main
from behavexplor.data.validation import checked
from behavexplor.envs.making import ENTRY_POINTS, environment_id
from behavexplor.repair.cases import Case
from behavexplor.sb3 import FuzzCallback
from tests.pages.blocks import PAGES, ROOT, Block, arguments_of, blocks_of, lowered

BLOCKS = {page.relative_to(ROOT).as_posix(): blocks_of(page) for page in PAGES}
LANGUAGES = {"python", "sh", "yaml", "toml", ""}
NOT_RUN = {  # shell lines that do not run, or their beginnings up to a space, and why
    "./run test": "it would run this test",
    "./run bench paper": "it takes hours",
    "./run bench paper --tables-only": "it needs the campaigns of the line before",
    "pip install ": "it would change the environment of the tests",
    "docker ": "another program",
    "python scenario_runner.py ": "another program, which needs CARLA",
    "esmini ": "another program, which is not installed here",
    "behavexplor fuzz --env lane-follow --ads rule:hardened --cluster ": "tests/execution starts clusters",
    "ray ": "for other machines",
    "./run fuzz --env highway-fast-v0 --ads my_rllib:Checkpoint": "tests/ads/weights runs it where RLlib is installed",
    "export ": "it has to be set before Python starts",
}
SLOW = {
    "README.md",
    "docs/experiments.md",
    "docs/extending.md",
    "docs/highway-env.md",
    "docs/policies.md",
    "docs/python.md",
    "docs/rates.md",
    "docs/repair.md",
    "docs/highway-policies.md",
}
JUDGED = {OK, CHECK_FAILED, UNDECIDED}
CODES = {"check": JUDGED, "evaluate": JUDGED, "compare": JUDGED}  # with as few scenarios as here
A_COMMAND = re.compile(r"\s*(\./run|behavexplor|python|pip|import|from) ")

FILES = {  # what is in the folder besides the files that the pages show
    "my_package/search.py": "from behavexplor.fuzz.uniform import Uniform as MySearch",
    "onnxruntime.py": "import numpy as np\n\nclass InferenceSession:\n    def __init__(self, path):\n        pass\n\n"
    "    def run(self, names, inputs):\n        return [np.eye(5)[[1] * len(inputs['obs'])]]\n",
}


def described(text):
    """The file beside a model."""
    folder = Path("described")
    folder.mkdir(exist_ok=True)
    (folder / "vecnormalize.pkl").touch()
    (folder / "model.yaml").write_text(text)
    return describe(folder / "model.zip")


def experiment(text):
    """The file of an experiment."""
    Path("experiment.yaml").write_text(text)
    return read_experiment("experiment.yaml")


def callback(text):
    """The callback in a hyperparameter file of rl-zoo3."""
    ((settings,),) = [one["callback"] for one in yaml.safe_load(text).values()]
    return FuzzCallback(**settings["behavexplor.sb3.FuzzCallback"])


def declared_environments(text):
    """The modules of environments that a package's pyproject.toml declares."""
    return tomllib.loads(text)["project"]["entry-points"][ENTRY_POINTS]


def workflow(text):
    """The steps of a workflow, whose commands exist and take these flags."""
    steps = [step["run"] for job in yaml.safe_load(text)["jobs"].values() for step in job["steps"] if "run" in step]
    commands = [step for step in steps if step.startswith("behavexplor ")]
    for command in commands:
        asked = {word for word in command.split() if word.startswith("--")}
        with redirect_stdout(StringIO()) as shown, pytest.raises(SystemExit):
            main([command.split()[1], "--help"])
        assert not [flag for flag in asked if flag not in shown.getvalue()], command
    return commands


POLICIES = Path(behavexplor.ads.learned.__file__).parent / "policies"
YAML = {  # how the YAML of each page is read
    "docs/ci.md": workflow,
    "docs/experiments.md": experiment,
    "docs/extending.md": experiment,
    "docs/policies.md": described,
    "docs/python.md": callback,
    "docs/rates.md": lambda text: listed(yaml.safe_load(text)),
    "docs/repair.md": lambda text: checked(Case, yaml.safe_load(text), "page"),
    "docs/highway-policies.md": described,
}


def pages(*, slow):
    return [pytest.param(page, id=page) for page, blocks in BLOCKS.items() if blocks and (page in SLOW) == slow]


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A finished run with failures."""
    folder = tmp_path_factory.mktemp("pages") / "run"
    search = ["fuzz", "--ads", "tests.drivers:cruiser", "--method", "uniform", "--seed", "5", "--budget", "6"]
    assert main([*search, "--workers", "0", "--unconfined", "--quiet", "--out", str(folder)]) == OK
    return folder


@cache
def model_of(env):
    """A policy of Stable-Baselines3 that has not been trained."""
    return PPO("MlpPolicy", gymnasium.make(environment_id(env)), n_steps=2, batch_size=2, device="cpu", seed=0)


@pytest.fixture
def folder(run_folder, tmp_path, monkeypatch):
    """A folder in which a page is tried, with all that the pages take for granted."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    shutil.copytree(run_folder, tmp_path / "RUN")
    shutil.copy(POLICIES / "lane-follow.npz", "policy.npz")
    yield tmp_path
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


def given(arguments):
    """The arguments with names of what there is."""
    first, second = open_run("RUN").failures.index[:2]
    words = {
        "runs/lane-follow-ppo-0/policy.npz": "policy.npz",
        "17": str(first),
        "43": str(second),
        "A": "constant",
        "B": "idm",
        "NAME": "lane-follow",
    }
    return [words.get(word, word).replace("000017", f"{first:06}") for word in arguments]


def is_excepted(line, one):
    """True if an exception covers a line: the whole line, or its beginning if the exception ends in a space."""
    return line == one or (one.endswith(" ") and line.startswith(one))


def run_line(line):
    """Run a line of the shell, unless it is not run."""
    if any(is_excepted(line, one) for one in NOT_RUN):
        return
    arguments = arguments_of(line)
    assert arguments is not None, f"{line!r} is neither a command of behavexplor nor in NOT_RUN"
    for model in {"model.zip", "old.zip", "new.zip", "policy.zip", "released.zip"} & {*arguments}:
        env = arguments[arguments.index("--env") + 1] if "--env" in arguments else "lane-change"
        model_of(env).save(model)
    if "weights.pth" in arguments:
        torch.save(
            torch.nn.Sequential(torch.nn.Linear(25, 8), torch.nn.ReLU(), torch.nn.Linear(8, 5)).state_dict(),
            "weights.pth",
        )
    code = main(given(arguments))
    assert code in CODES.get(arguments[0], {OK}), line


def run_python(block, page):
    """Run a block of Python, and the tests that it defines."""
    before = set(page.__dict__)
    exec(compile(lowered(block.text), f"{block.page}:{block.line}", "exec"), page.__dict__)
    for name in set(page.__dict__) - before:
        if name.startswith("test_"):
            page.__dict__[name]()


def run_block(block, page):
    if block.file:
        Path(block.file).write_text(block.text)
    if block.language == "python":
        run_python(block, page)
    elif block.language == "sh":
        for line in block.commands:
            run_line(line)
    elif block.language == "yaml":
        assert YAML[block.page](block.text)
    elif block.language == "toml":
        assert declared_environments(block.text)


def run_page(name, monkeypatch):
    page = ModuleType("page")  # requirements are found again by the name of their module
    monkeypatch.setitem(sys.modules, "page", page)
    if name in ("README.md", "docs/rates.md"):
        page.model, page.behavexplor = model_of("highway-fast-v0"), behavexplor
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a policy that has not been trained may be constant
        for block in BLOCKS[name]:
            run_block(block, page)


@pytest.mark.parametrize("name", pages(slow=False))
def test_the_blocks_of_a_page_run(name, folder, monkeypatch):
    run_page(name, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("name", pages(slow=True))
def test_the_blocks_of_a_long_page_run(name, folder, monkeypatch):
    run_page(name, monkeypatch)


def every_block():
    return [block for blocks in BLOCKS.values() for block in blocks]


def test_every_block_says_what_it_is():
    """A block without a language is output, and does not begin with a command."""
    assert len(every_block()) > 50
    for block in every_block():
        place = f"{block.page}:{block.line}"
        assert block.language in LANGUAGES, place
        assert block.language or not A_COMMAND.match(block.text), place
        assert block.language != "yaml" or block.page in YAML, place


def test_every_exception_is_needed():
    lines = [line for block in every_block() if block.language == "sh" for line in block.commands]
    assert not [one for one in NOT_RUN if not any(is_excepted(line, one) for line in lines)]
    assert set(BLOCKS) >= SLOW


@pytest.mark.parametrize("line", ["./run fuss --env lane-follow", "curl example.org"])
def test_a_line_that_does_not_run_fails(line, folder):
    with pytest.raises((AssertionError, SystemExit)):
        run_line(line)


def test_an_exception_does_not_cover_a_longer_line():
    assert is_excepted("ray start --head", "ray ")
    assert is_excepted("./run bench paper", "./run bench paper")
    assert not is_excepted("./run bench paper --dry-run", "./run bench paper")


def test_counts_are_lowered():
    assert lowered("find_failures(model, budget=300).learn(1_000_000)") == "find_failures(model, budget=16).learn(16)"
    block = Block("page", 1, "sh", "./run fuzz --budget 900  # long\n\n")
    assert block.commands == ["./run fuzz --budget 900"]
    assert arguments_of(block.commands[0])[1:3] == ["--budget", "16"]
