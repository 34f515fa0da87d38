"""Small models for the tests, and files that want to run something."""

import base64
import json
import os
import pickle
import zipfile
from pathlib import Path

import gymnasium
import numpy as np
import sb3_contrib
import stable_baselines3
import torch

BOX = gymnasium.spaces.Box(-np.inf, np.inf, (7, 5), np.float32)
COMMANDS = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
META = gymnasium.spaces.Discrete(5)

ALGORITHMS = {
    "PPO": (stable_baselines3, COMMANDS, {"policy_kwargs": {"net_arch": [8, 8], "activation_fn": torch.nn.ReLU}}),
    "A2C": (stable_baselines3, COMMANDS, {"use_sde": True}),
    "DQN": (stable_baselines3, META, {"buffer_size": 100}),
    "SAC": (stable_baselines3, COMMANDS, {"buffer_size": 100}),
    "TD3": (stable_baselines3, COMMANDS, {"buffer_size": 100}),
    "DDPG": (stable_baselines3, COMMANDS, {"buffer_size": 100}),
    "RecurrentPPO": (sb3_contrib, COMMANDS, {}),
    "MaskablePPO": (sb3_contrib, META, {}),
    "QRDQN": (sb3_contrib, META, {"buffer_size": 100}),
    "TQC": (sb3_contrib, COMMANDS, {"buffer_size": 100}),
    "TRPO": (sb3_contrib, COMMANDS, {}),
    "ARS": (sb3_contrib, COMMANDS, {}),
    "CrossQ": (sb3_contrib, COMMANDS, {"buffer_size": 100}),
}


class Still(gymnasium.Env):
    """Has spaces, and nothing else."""

    def __init__(self, observation_space=BOX, action_space=COMMANDS):
        self.observation_space, self.action_space = observation_space, action_space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, False, False, {}


def make_model(name, observation_space=BOX, action_space=None, **changed):
    """An untrained model of an algorithm."""
    library, commands, keywords = ALGORITHMS[name]
    kind = "MultiInput" if isinstance(observation_space, gymnasium.spaces.Dict) else "Mlp"
    policy = f"{kind}LstmPolicy" if name == "RecurrentPPO" else f"{kind}Policy"
    env = Still(observation_space, action_space or commands)
    return getattr(library, name)(policy, env, device="cpu", seed=0, **{**keywords, **changed})


class Payload:
    """Makes a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def poison(source: Path, target: Path, place: str, proof: Path) -> Path:
    """A copy of a model's file that makes a folder when one place of it is unpickled."""
    payload = pickle.dumps(Payload(proof))
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "data" and place not in old.namelist():
                data = json.loads(content)
                data[place] = {":type:": "x", ":serialized:": base64.b64encode(payload).decode()}
                content = json.dumps(data).encode()
            elif name == place:
                buffer = target.with_suffix(".pth")
                torch.save(Payload(proof), buffer)
                content = buffer.read_bytes()
            new.writestr(name, content)
    return target
