"""Policies that go on learning: a network of `train`, or a model of Stable-Baselines3."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch
import yaml
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from behavexplor.ads.learned.learning import LearningVecEnv
from behavexplor.ads.learned.network_file import read_network, write_network
from behavexplor.ads.learned.shipped import policy_file
from behavexplor.ads.sb3.archive import read_archive
from behavexplor.ads.sb3.continuing import continued, learning_rate_of, sub_environments_of
from behavexplor.ads.sb3.dense_layers import dense_layers, trained_network
from behavexplor.ads.sb3.description import ENVIRONMENT_KEYS, OWN, WEIGHTS, describe, find_model
from behavexplor.data.durable import write_durably, write_saved
from behavexplor.data.scripted_logical import require_scripted
from behavexplor.data.target import Target
from behavexplor.data.untrusted import read_file
from behavexplor.envs.making import make_vector_env
from behavexplor.envs.sb3_vec_env import ScenarioVecEnv
from behavexplor.errors import InputError
from behavexplor.execution.simulation import Simulation
from behavexplor.repair.retraining_rounds import DivergedError
from behavexplor.training import TrainingConfig, begin_stage, load_layers, new_model

_ENVS: Final = 64  # sub-environments for a network of `train`
_RATE: Final = 2.5e-4  # learning rate where none is known


@dataclass(frozen=True)
class Trainee:
    """A policy that goes on learning."""

    model: BaseAlgorithm  # the model. A replay buffer is filled anew at the beginning of each round.
    venv: VecEnv  # its environment
    suffix: str  # suffix of its file
    rate: float  # learning rate of the training so far, or a usual one
    entropy: float  # weight of the entropy bonus in that training
    new_critic: bool  # whether its critic is untrained, because the file has none
    write: Callable[[Path], None]  # function that writes the present policy to a file
    scenarios: ScenarioVecEnv  # the environment that draws the scenarios

    def learn(self, seed: int, number: int, steps: int, rate: float, watch: BaseCallback) -> None:
        """Train for round `number`, counted from 1: `steps` decisions at a learning rate.

        In the first round, a new critic first learns alone for as many decisions. `seed` is that of the retraining.

        Raises:
            DivergedError: if the network has weights that are not finite numbers afterwards.
        """
        try:
            self._learn(seed, number, steps, rate, watch)
        except ValueError as error:  # torch refuses to draw from a distribution that is not finite
            if self._is_finite():
                raise
            raise DivergedError(number) from error
        if not self._is_finite():
            raise DivergedError(number)

    def _is_finite(self) -> bool:
        return all(bool(torch.isfinite(weights).all()) for weights in self.model.policy.parameters())

    def _learn(self, seed: int, number: int, steps: int, rate: float, watch: BaseCallback) -> None:
        model: Any = self.model
        if self.new_critic and number == 1:
            _freeze(model, frozen=True)
            begin_stage(model, self.venv, (seed, 0), rate)
            model.learn(steps, reset_num_timesteps=False)
            _freeze(model, frozen=False)
        begin_stage(model, self.venv, (seed, number), rate)
        if isinstance(model, OffPolicyAlgorithm):
            self._fill(model)
        model.learn(steps, callback=watch, reset_num_timesteps=False)

    def _fill(self, model: Any) -> None:
        """Fill the replay buffer by the present policy, with as many decisions as before the first training."""
        model.replay_buffer.reset()
        model._n_calls = 0  # noqa: SLF001 - when the target network is next updated
        count, model.learning_starts = model.learning_starts, 0
        gradient_steps, model.gradient_steps = model.gradient_steps, 0  # nothing is learned meanwhile
        model.learn(max(count, model.batch_size), reset_num_timesteps=False)
        model.learning_starts, model.gradient_steps = count, gradient_steps


def given_file(policy: str) -> Path:
    """Return the file of a policy: a network of `train`, or a model of Stable-Baselines3.

    Raises:
        InputError: if there is no such file, or it cannot learn.
    """
    path = policy_file(policy)
    if not path.exists():
        raise InputError(f"There is no policy {path}")
    if path.suffix in WEIGHTS:
        raise InputError(f"{path} holds weights alone, without what trained them: retrain a model.zip or a policy.npz")
    return path if path.suffix == ".npz" else find_model(path)


def open_trainee(target: Target, seed: int, envs: int | None = None) -> Trainee:
    """Return a policy that can go on learning. Its environment draws from the logical scenario.

    `seed` is for weights that the file lacks. `envs` is the number of sub-environments; by default, that of the
    training so far, or a usual one.

    Raises:
        InputError: if the policy cannot go on learning, or not in this environment.
    """
    path = given_file(target.ads)  # first, because a driver of another kind would run its code
    simulation = Simulation(target.env, target.ads, env_config=target.env_config, traffic=target.traffic)
    made = _of_network if path.suffix == ".npz" else _of_model
    return made(simulation, target.env, path, seed, envs)


def _of_network(simulation: Simulation, env: str, path: Path, seed: int, envs: int | None) -> Trainee:
    """Return a policy whose network is that of a file, with a new critic."""
    network = read_network(path)
    scenarios = _scenarios(simulation, envs or _ENVS)
    venv = LearningVecEnv(scenarios, require_scripted(simulation.logical, "Training of a network").roadmap)
    layers = tuple(len(bias) for _, bias in network.layers[:-1])
    model = new_model(TrainingConfig(seed=seed, envs=venv.num_envs, layers=layers), venv)
    load_layers(model, network.layers)

    def write(file: Path) -> None:
        write_network(file, trained_network(model.policy))
        write_durably(file.with_suffix(OWN[0]), yaml.safe_dump({"training": {"env": env}}))

    return Trainee(model, venv, ".npz", _RATE, _entropy(model), True, write, scenarios)


def _of_model(simulation: Simulation, env: str, path: Path, seed: int, envs: int | None) -> Trainee:
    """Return the model of a zip file of Stable-Baselines3."""
    described = describe(path)
    if described.decision is not None:
        raise InputError(
            f"{path} is a network of `train` as a model: retrain the network (.npz), or go on in your own script, in "
            f"behavexplor.sb3.learning_env"
        )
    for name, given in (("normalized", described.statistics), ("stacked", described.frame_stack > 1)):
        if given:
            raise InputError(f"{path} cannot be trained further here: its observations are {name}")
    archive = read_archive(path)
    scenarios = _scenarios(simulation, envs or sub_environments_of(archive))
    torch.manual_seed(seed)
    model = continued(archive, scenarios)
    settings = {"env": env, **_settings(simulation)}

    def write(file: Path) -> None:
        write_saved(file, model.save)
        write_durably(file.with_suffix(".yaml"), yaml.safe_dump(settings, sort_keys=False))

    rate = learning_rate_of(archive) or _RATE
    return Trainee(model, scenarios, ".zip", rate, _entropy(model), False, write, scenarios)


def _entropy(model: Any) -> float:
    return float(getattr(model, "ent_coef", 0.0))


def _scenarios(simulation: Simulation, count: int) -> ScenarioVecEnv:
    envs = make_vector_env(simulation.env, count, {}, rewards=True)
    if envs is None:
        raise InputError("The environment has no vector form, which training needs")
    return ScenarioVecEnv(envs)


def _settings(simulation: Simulation) -> Mapping[str, Any]:
    """Return what the file beside a model says of the configuration of its environment."""
    if config := simulation.logical.config:
        return {"config": config}
    return {key: getattr(simulation.ads, key) for key in ENVIRONMENT_KEYS if hasattr(simulation.ads, key)}


def copy_policy(policy: Path, path: Path) -> None:
    """Copy a policy with the file beside it."""
    for suffix in (path.suffix, *OWN):
        if policy.with_suffix(suffix).is_file():
            write_durably(path.with_suffix(suffix), read_file(policy.with_suffix(suffix)))


def _freeze(model: BaseAlgorithm, *, frozen: bool) -> None:
    for layer in dense_layers(model.policy):
        layer.requires_grad_(not frozen)
