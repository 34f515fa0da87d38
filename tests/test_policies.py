"""Trained policies from the file to the verdict: they drive here as where they were trained."""

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

import behavexplor  # noqa: F401 - registers the environments
from behavexplor.ads.sb3.highway_fit import HIGHWAY_ENVIRONMENTS
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.errors import InputError
from behavexplor.execution.preflight import preflight_warnings
from behavexplor.execution.simulation import Simulation
from tests.ads.sb3.models import make_model, poison

ENV = "behavexplor/lane-follow-v0"


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A policy that was trained a little on scaled observations, and its files."""
    folder = tmp_path_factory.mktemp("trained")
    env = VecNormalize(DummyVecEnv([lambda: gymnasium.make(ENV)] * 2), clip_obs=5.0)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=32, seed=0, device="cpu", policy_kwargs={"net_arch": [16]})
    model.learn(256)
    model.save(folder / "model")
    env.save(str(folder / "vecnormalize.pkl"))
    env.close()
    return folder


def evaluated(folder, scenario):
    """The commands of an episode as Stable-Baselines3 itself would run it."""
    env = VecNormalize.load(str(folder / "vecnormalize.pkl"), DummyVecEnv([lambda: gymnasium.make(ENV)]))
    env.training = env.norm_reward = False
    model = PPO.load(folder / "model", device="cpu")
    env.set_options({"scenario": scenario})
    observation, done, actions = env.reset(), np.array([False]), []
    while not done:
        action, _ = model.predict(observation, deterministic=True)
        actions.append(action[0])
        observation, _, done, infos = env.step(action)
    env.close()
    return np.array(actions), infos[0]["trace"]


def test_a_policy_drives_as_in_its_own_evaluation(trained):
    simulation = Simulation("lane-follow", str(trained / "model.zip"))
    generator = np.random.default_rng(5)
    for _ in range(3):
        scenario = simulation.logical.sample(generator)
        trace = simulation.run(scenario)
        actions, expected = evaluated(trained, scenario)
        np.testing.assert_allclose(trace.actions, actions, rtol=0, atol=1e-4)
        np.testing.assert_allclose(trace.position, expected.position, rtol=0, atol=1e-2)
        assert trace.end == expected.end
    simulation.close()


def test_missing_statistics_are_named_by_the_health_check(trained, tmp_path):
    (tmp_path / "model.zip").write_bytes((trained / "model.zip").read_bytes())
    findings = {
        folder: preflight_warnings(Simulation("lane-follow", str(folder / "model.zip")))
        for folder in (trained, tmp_path)
    }
    assert not any("VecNormalize" in finding for finding in findings[trained])
    assert any("statistics of VecNormalize missing" in finding for finding in findings[tmp_path])


def test_a_policys_file_is_fuzzed_from_the_command_line(trained, tmp_path, capsys):
    run = tmp_path / "run"
    policy = str(trained / "model.zip")
    flags = ["--env", "lane-follow", "--ads", policy, "--budget", "2", "--workers", "1", "--out", str(run)]
    assert main(["fuzz", *flags]) == OK
    assert main(["replay", str(run), "0"]) == OK
    assert "running it again gave the same trace" in capsys.readouterr().out


@pytest.mark.parametrize("command", [["fuzz", "--budget", "1"], ["evaluate", "--scenarios", "1"]])
def test_what_is_suspicious_in_a_policys_file_is_printed_before_anything_else(command, trained, tmp_path, capfd):
    poisoned = poison(trained / "model.zip", tmp_path / "model.zip", "new_key", tmp_path / "proof")
    out = ["--out", str(tmp_path / "run")] if command[0] == "fuzz" else []
    assert main([*command, "--env", "lane-follow", "--ads", str(poisoned), "--workers", "1", *out]) == OK
    printed = capfd.readouterr().err.splitlines()
    warning = f"Warning: {poisoned}: 'new_key' of its data calls posix.mkdir, which was not run"
    assert printed.count(warning) == 1
    assert any("statistics of VecNormalize missing" in line for line in printed)
    assert not (tmp_path / "proof").exists()


@pytest.mark.parametrize(
    ("observations", "commands", "hint"),
    [
        ((15, 7), gymnasium.spaces.Discrete(3), "highway-env's intersection-v0"),
        ((5, 8), gymnasium.spaces.Box(-1, 1, (2,)), "highway-env's intersection-v1"),
        ((5, 5), gymnasium.spaces.Discrete(5), "highway-env's highway-v0"),
        ((9, 7), gymnasium.spaces.Discrete(5), "vehicles_count: 9, features: [presence, x, y, vx, vy, cos_h, sin_h]"),
        ((4, 4, 4, 4), gymnasium.spaces.Discrete(17), "Give highway-env's `observation` and `action` configuration"),
    ],
)
def test_a_policy_of_other_spaces_is_refused_with_what_would_fit(observations, commands, hint, tmp_path, capsys):
    space = gymnasium.spaces.Box(-np.inf, np.inf, observations, np.float32)
    algorithm = "DQN" if isinstance(commands, gymnasium.spaces.Discrete) else "PPO"
    make_model(algorithm, space, commands).save(tmp_path / "model")
    assert (
        main(["fuzz", "--env", "lane-follow", "--ads", str(tmp_path / "model.zip"), "--workers", "0", "--unconfined"])
        == BAD_INPUT
    )
    message = capsys.readouterr().err
    assert "but the environment 'behavexplor/lane-follow-v0' has Box(7, 5) and Box(2,)" in message
    assert hint in message


@pytest.mark.parametrize("name", ["intersection-v0", "intersection-v1", "highway-v0"])
def test_what_is_said_to_fit_does_fit(name, tmp_path, capsys):
    with gymnasium.make("behavexplor/lane-follow-v0", config=dict(HIGHWAY_ENVIRONMENTS[name])) as env:
        spaces = env.observation_space, env.action_space
    algorithm = "DQN" if isinstance(spaces[1], gymnasium.spaces.Discrete) else "PPO"
    make_model(algorithm, *spaces).save(tmp_path / "model")
    assert main(["fuzz", "--ads", str(tmp_path / "model.zip"), "--workers", "0", "--unconfined"]) == BAD_INPUT
    advice = capsys.readouterr().err.strip().partition(" your driver: ")[2]
    (tmp_path / "model.yaml").write_text(advice)
    flags = ["--budget", "1", "--workers", "0", "--unconfined", "--out", str(tmp_path / "run")]
    assert main(["fuzz", "--ads", str(tmp_path / "model.zip"), *flags]) == OK


def test_a_policy_of_another_environment_is_told_which(tmp_path):
    with gymnasium.make("behavexplor/lane-change-v0") as env:
        make_model("PPO", env.observation_space, env.action_space).save(tmp_path / "model")
    with pytest.raises(
        InputError, match=r"It fits lane-change, lane-follow without a configuration: should --env name one of these"
    ):
        Simulation("intersection-straight", str(tmp_path / "model.zip"))


def test_trust_in_something_that_is_no_digest_is_refused(capsys):
    assert main(["fuzz", "--trust", "yes"]) == BAD_INPUT
    assert "must be sha256: and the 64 hexadecimal digits" in capsys.readouterr().err


def test_a_policy_drives_alike_to_the_last_bit_in_any_company(tmp_path):
    env = gymnasium.make(ENV, disable_env_checker=True)
    model = PPO("MlpPolicy", env, device="cpu", seed=3, policy_kwargs={"net_arch": [10, 10]})
    with torch.no_grad():
        model.policy.action_net.bias[0] = 0.6  # it sets out
    model.save(tmp_path / "model.zip")
    simulation = Simulation("lane-follow", str(tmp_path / "model.zip"))
    generator = np.random.default_rng(6)
    scenarios = [simulation.logical.sample(generator) for _ in range(5)]
    alone = [simulation.run(scenario).to_bytes() for scenario in scenarios]
    for number, trace in simulation.run_all(scenarios, 3):
        assert trace.to_bytes() == alone[number]
    simulation.close()
