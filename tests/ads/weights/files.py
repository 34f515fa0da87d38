"""Files of weights as scripts write them: each with what the script does, and with what it cannot say in the file."""

import json
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import safetensors.torch
import torch
from torch import nn

KINEMATICS = gymnasium.spaces.Box(-np.inf, np.inf, (5, 5), np.float32)
GRID = gymnasium.spaces.Box(-1.0, 1.0, (4, 11, 11), np.float32)
META = gymnasium.spaces.Discrete(5)
COMMANDS = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
GRID_CONFIG = {"observation": {"type": "OccupancyGrid", "features": ["presence", "vx", "vy", "on_road"]}}
CONTINUOUS = {"action": {"type": "ContinuousAction"}}


def dense(*widths, function=nn.ReLU):
    """Dense layers with a function between them."""
    layers = [layer for pair in pairwise(widths) for layer in (nn.Linear(*pair), function())]
    return nn.Sequential(*layers[:-1])


class Tutorial(nn.Module):
    """The network of PyTorch's tutorial on DQN."""

    def __init__(self):
        super().__init__()
        self.layer1, self.layer2, self.layer3 = nn.Linear(25, 128), nn.Linear(128, 128), nn.Linear(128, 5)

    def forward(self, seen):
        return self.layer3(torch.relu(self.layer2(torch.relu(self.layer1(seen.flatten(1))))))


class OfCleanRL(nn.Module):
    """DQN's network in CleanRL."""

    def __init__(self):
        super().__init__()
        self.network = dense(25, 120, 84, 5)

    def forward(self, seen):
        return self.network(seen.flatten(1))


class Dueling(nn.Module):
    def __init__(self):
        super().__init__()
        self.feature = nn.Sequential(nn.Linear(25, 64), nn.ReLU())
        self.advantage, self.value = dense(64, 64, 5), dense(64, 64, 1)

    def forward(self, seen):
        shared = self.feature(seen.flatten(1))
        advantage = self.advantage(shared)
        return self.value(shared) + advantage - advantage.mean(1, keepdim=True)


class ConvolutionalDueling(nn.Module):
    """Both heads follow the convolutions, and each flattens their output."""

    def __init__(self):
        super().__init__()
        self.features = nn.Sequential(nn.Conv2d(4, 8, 3), nn.ReLU(), nn.Conv2d(8, 4, 2), nn.ReLU())
        self.advantage, self.value = dense(256, 16, 5), dense(256, 16, 1)

    def forward(self, seen):
        shared = self.features(seen).flatten(1)
        advantage = self.advantage(shared)
        return self.value(shared) + advantage - advantage.mean(1, keepdim=True)


class ActorCritic(nn.Module):
    def __init__(self):
        super().__init__()
        self.fc1, self.fc2 = nn.Linear(25, 64), nn.Linear(64, 64)
        self.actor, self.critic = nn.Linear(64, 5), nn.Linear(64, 1)

    def forward(self, seen):
        return self.actor(torch.tanh(self.fc2(torch.tanh(self.fc1(seen.flatten(1))))))


class Gaussian(nn.Module):
    """PPO's agent for continuous actions in CleanRL."""

    def __init__(self):
        super().__init__()
        self.critic, self.actor_mean = dense(25, 64, 64, 1, function=nn.Tanh), dense(25, 64, 64, 2, function=nn.Tanh)
        self.actor_logstd = nn.Parameter(torch.full((1, 2), -0.5))

    def forward(self, seen):
        return self.actor_mean(seen.flatten(1)).clamp(-1, 1)


class SoftActor(nn.Module):
    """SAC's actor."""

    def __init__(self):
        super().__init__()
        self.fc1, self.fc2 = nn.Linear(25, 64), nn.Linear(64, 64)
        self.fc_mean, self.fc_logstd = nn.Linear(64, 2), nn.Linear(64, 2)

    def forward(self, seen):
        return torch.tanh(self.fc_mean(torch.relu(self.fc2(torch.relu(self.fc1(seen.flatten(1)))))))


class Convolutional(nn.Module):
    def __init__(self):
        super().__init__()
        self.conv1, self.conv2 = nn.Conv2d(4, 8, 3, stride=2, padding=1), nn.Conv2d(8, 16, 3)
        self.fc1, self.fc2 = nn.Linear(16 * 4 * 4, 64), nn.Linear(64, 5)

    def forward(self, seen):
        grid = torch.relu(self.conv2(torch.relu(self.conv1(seen))))
        return self.fc2(torch.relu(self.fc1(grid.flatten(1))))


class OfRlAgents(nn.Module):
    """rl_agents' DuelingNetwork, as far as its layers have names."""

    def __init__(self):
        super().__init__()
        self.base_module = nn.Module()
        self.base_module.layers = nn.ModuleList([nn.Linear(25, 64), nn.Linear(64, 64)])
        self.advantage, self.value = nn.Linear(64, 5), nn.Linear(64, 1)

    def forward(self, seen):
        shared = seen.flatten(1)
        for layer in self.base_module.layers:
            shared = torch.tanh(layer(shared))
        advantage = self.advantage(shared)
        return self.value(shared) + advantage - advantage.mean(1, keepdim=True)


@dataclass(frozen=True)
class Form:
    """How a script keeps its network.

    Attributes:
        network: the network.
        kept: function from it to what is stored.
        settings: what the file beside it says.
        spaces: spaces of the environment's observations and actions.
        name: name of the file.
        config: configuration of highway-env.
    """

    network: type
    kept: Any = lambda network: network.state_dict()
    settings: dict[str, Any] = field(default_factory=dict)
    spaces: tuple[Any, Any] = (KINEMATICS, META)
    name: str = "weights.pth"
    config: dict[str, Any] = field(default_factory=dict)


def checkpoint(network):
    """A checkpoint with a target network, an optimizer and numbers beside."""
    optimizer = torch.optim.Adam(network.parameters())
    network(torch.zeros(1, 5, 5)).sum().backward()
    optimizer.step()
    other = type(network)()
    states = {"policy_state_dict": network.state_dict(), "target_state_dict": other.state_dict()}
    return {**states, "optimizer_state_dict": optimizer.state_dict(), "epsilon": np.float64(0.1), "rewards": [1.0, 2.0]}


RELU, TANH = {"activation": "relu"}, {"activation": "tanh"}
FORMS = {
    "tutorial": Form(Tutorial, settings=RELU),
    "cleanrl": Form(OfCleanRL, settings=RELU, name="dqn.cleanrl_model"),
    "dueling": Form(Dueling, settings=RELU, name="weights.pt"),
    "actor-critic": Form(ActorCritic, settings=TANH),
    "checkpoint": Form(Tutorial, checkpoint, RELU, name="checkpoint.pth"),
    "safetensors": Form(Tutorial, settings=RELU, name="weights.safetensors"),
    "convolutional": Form(
        Convolutional, settings={**RELU, "strides": [2, 1], "paddings": [1, 0]}, spaces=(GRID, META), config=GRID_CONFIG
    ),
    "convolutional dueling": Form(
        ConvolutionalDueling, settings={**RELU, "strides": [1, 1]}, spaces=(GRID, META), config=GRID_CONFIG
    ),
    "gaussian": Form(Gaussian, settings=TANH, spaces=(KINEMATICS, COMMANDS), config=CONTINUOUS),
    "soft": Form(SoftActor, settings={**RELU, "squash": True}, spaces=(KINEMATICS, COMMANDS), config=CONTINUOUS),
    "rl_agents": Form(
        OfRlAgents, lambda network: {"state_dict": network.state_dict(), "optimizer": {}}, name="checkpoint-best.tar"
    ),
}


def write(form: Form, folder: Path) -> tuple[Path, nn.Module]:
    """Write the file of a form with what is beside it, and return its path and its network."""
    torch.manual_seed(7)
    network, path = form.network(), folder / form.name
    if path.suffix == ".safetensors":
        safetensors.torch.save_file(form.kept(network), path)
    else:
        torch.save(form.kept(network), path)
    if form.name.endswith(".tar"):
        model = {"type": "DuelingNetwork", "base_module": {"type": "MultiLayerPerceptron", "activation": "TANH"}}
        env = {"id": "highway-fast-v0", "duration": 20, "__class__": "<class 'HighwayEnvFast'>"}
        agent = {"__class__": "<class 'rl_agents.agents.deep_q_network.pytorch.DQNAgent'>", "model": model}
        (folder / "metadata.0.123.json").write_text(json.dumps({"agent": agent, "env": env}))
    else:
        (folder / f"{path.stem}.yaml").write_text(json.dumps({**form.settings, "config": form.config}))
    return path, network
