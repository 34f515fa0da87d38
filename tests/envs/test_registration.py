"""The environments as another project meets them."""

import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium
import highway_env  # noqa: F401 - registers its environments
import pytest

import behavexplor

SCRIPT = """
import gymnasium
import behavexplor
ids = [f"behavexplor/{name}-v0" for name in behavexplor.FUNCTIONAL_SCENARIOS]
assert len(ids) >= 4, ids
for name in ids:
    env = gymnasium.wrappers.RecordVideo(gymnasium.make(name, render_mode="rgb_array"), "videos", name_prefix=name[12:])
    env.reset(seed=0)
    for _ in range(20):
        env.step(env.action_space.sample())
    env.close()
"""


def run(code, cwd):
    return subprocess.run(
        [sys.executable, "-c", code], cwd=cwd, capture_output=True, text=True, timeout=120, check=False
    )


def test_the_functional_scenarios_of_the_paper_are_there():
    assert set(behavexplor.FUNCTIONAL_SCENARIOS) >= {
        "intersection-straight",
        "intersection-left",
        "lane-follow",
        "lane-change",
    }


@pytest.mark.parametrize("name", behavexplor.HIGHWAY_ENV)
def test_highway_env_s_own_are_registered_as_it_registers_them(name):
    ours, theirs = gymnasium.spec(f"behavexplor/{name}"), gymnasium.spec(name)
    assert (ours.entry_point, ours.max_episode_steps) == (theirs.entry_point, theirs.max_episode_steps)
    assert not theirs.additional_wrappers


@pytest.mark.parametrize("name", behavexplor.FUNCTIONAL_SCENARIOS)
def test_each_is_named_after_its_scenario(name):
    env = gymnasium.make(f"behavexplor/{name}-v0").unwrapped
    assert env.logical.name == name
    assert env.__doc__


def test_registering_again_changes_nothing():
    code = (
        "import importlib, gymnasium, behavexplor; before = dict(gymnasium.registry); importlib.reload(behavexplor); "
        "assert dict(gymnasium.registry) == before; "
        "import gymnasium as g; others = [n for n in g.registry if 'behavexplor' in n]; "
        "assert all(n.startswith('behavexplor/') for n in others)"
    )
    result = run(code, ".")
    assert (result.returncode, result.stderr) == (0, "")


def test_a_fresh_interpreter_finds_them_by_their_module(tmp_path):
    code = "import gymnasium; print(gymnasium.make('behavexplor:behavexplor/lane-follow-v0').reset(seed=0)[0].shape)"
    result = run(code, tmp_path)
    assert result.stdout == "(7, 5)\n", result.stderr


def test_spawned_workers_find_it(tmp_path):
    (tmp_path / "workers.py").write_text(
        "import gymnasium\n"
        "if __name__ == '__main__':\n"
        "    name = 'behavexplor:behavexplor/lane-follow-v0'\n"
        "    settings = {'vectorization_mode': 'async', 'vector_kwargs': {'context': 'spawn'}}\n"
        "    envs = gymnasium.make_vec(name, num_envs=2, **settings)\n"
        "    observations, _ = envs.reset(seed=1)\n"
        "    print(observations.shape)\n"
        "    envs.close()\n"
    )
    command = [sys.executable, "workers.py"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert result.stdout == "(2, 7, 5)\n", result.stderr


def test_another_project_makes_plays_and_records_each(tmp_path):
    pytest.importorskip("moviepy")
    result = run(SCRIPT, tmp_path)
    assert result.returncode == 0, result.stderr
    assert len(list((tmp_path / "videos").glob("*.mp4"))) == len(behavexplor.FUNCTIONAL_SCENARIOS)


FIFTH = """
import gymnasium, behavexplor
assert behavexplor.__file__.startswith({folder!r})
env = gymnasium.make("behavexplor/lane-keep-v0")
many = gymnasium.make_vec("behavexplor/lane-keep-v0", num_envs=2)
assert env.reset(seed=1)[1]["scenario"].functional == env.unwrapped.logical.name == many.logical.name
print(many.logical.name, len(behavexplor.FUNCTIONAL_SCENARIOS))
"""


def test_a_fifth_scenario_is_one_class_and_its_name(tmp_path):
    package = shutil.copytree(Path(behavexplor.__file__).parent, tmp_path / "behavexplor")
    scenarios = package / "envs" / "functional.py"
    added = """
import dataclasses


class LaneKeepEnv(DrivingEnv):
    logical = dataclasses.replace(LANE_FOLLOW, name="lane-keep")


LaneKeepVectorEnv = vector_env(LaneKeepEnv)
"""
    scenarios.write_text(scenarios.read_text() + added)
    names = (package / "__init__.py").read_text()
    (package / "__init__.py").write_text(names.replace('"lane-follow")', '"lane-follow", "lane-keep")'))
    result = run(FIFTH.format(folder=str(tmp_path)), tmp_path)
    assert result.stdout == f"lane-keep {len(behavexplor.FUNCTIONAL_SCENARIOS) + 1}\n", result.stderr
