"""The dense layers of a policy of Stable-Baselines3, from the observation to the preference of each action."""

from typing import Any

import numpy as np
import torch
from stable_baselines3.common.policies import BasePolicy

from behavexplor.ads.learned.network_file import Rule, TrainedNetwork
from behavexplor.errors import InputError


def dense_layers(policy: BasePolicy) -> list[torch.nn.Linear]:
    """Return the dense layers of an actor with tanh between them.

    Raises:
        InputError: if the policy has another form.
    """
    made: Any = policy
    try:
        parts = [*made.features_extractor.children(), *made.mlp_extractor.policy_net, made.action_net]
    except AttributeError:
        raise InputError(f"Expected a policy MlpPolicy of PPO, A2C or TRPO, got {type(policy).__name__}") from None
    layers = [part for part in parts if isinstance(part, torch.nn.Linear)]
    others = {type(part).__name__ for part in parts} - {"Linear", "Tanh", "Flatten"}
    if others:
        raise InputError(f"Expected dense layers with Tanh between them, got {', '.join(sorted(others))}, too")
    return layers


def trained_network(policy: BasePolicy, rule: Rule = "mean") -> TrainedNetwork:
    """Return an actor as a network that decides by a rule.

    Raises:
        InputError: if it is no actor with dense layers and tanh.
    """
    layers = [
        (
            np.asarray(layer.weight.detach().numpy(), dtype=np.float64),
            np.asarray(layer.bias.detach().numpy(), dtype=np.float64),
        )
        for layer in dense_layers(policy)
    ]
    return TrainedNetwork(layers, rule)
