"""Training of a driving policy with Stable-Baselines3 on the vector environment, in resumable stages.

Each stage begins with new episodes and with its own random generators, seeded by the seed of the training and the
number of the stage. So a training that resumes from the model at the end of a stage gives the same policy as an
uninterrupted one.
"""

import io
import re
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

import gymnasium
import numpy as np
import sb3_contrib
import stable_baselines3
import torch
import yaml
from pydantic import ConfigDict
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv

from behavexplor import FUNCTIONAL_SCENARIOS, HIGHWAY_ENV, NAMESPACE
from behavexplor.ads.learned.driver import POLICY_FREQUENCY, LearnedDriver
from behavexplor.ads.learned.learning import LearningVecEnv
from behavexplor.ads.learned.network_file import Layers, TrainedNetwork, write_network
from behavexplor.ads.sb3.dense_layers import dense_layers, trained_network
from behavexplor.ads.scene_io import ACTION, OBSERVATION
from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import MOST_ENVS
from behavexplor.data.durable import check_file, make_folder, write_durably, write_saved, writing
from behavexplor.data.untrusted import read_file
from behavexplor.data.validation import between, validated
from behavexplor.envs.making import environment_id
from behavexplor.envs.sb3_vec_env import DrivingVecEnv
from behavexplor.errors import InputError, unknown_name

CONFIG: Final = "training.yaml"  # this and the following are names in the folder of a training
NETWORK: Final = "policy.npz"
MODELS: Final = "models"
LOGS: Final = "logs"
EPISODES: Final = 1000  # latest episodes over which rates are reported

ALGORITHMS: Mapping[str, type[OnPolicyAlgorithm]] = {
    "ppo": stable_baselines3.PPO,
    "a2c": stable_baselines3.A2C,
    "trpo": sb3_contrib.TRPO,
}
_SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "ppo": {"n_steps": 128, "batch_size": 1024, "n_epochs": 4, "ent_coef": 0.005},
    "a2c": {"n_steps": 16, "ent_coef": 0.005},
    "trpo": {"n_steps": 128, "batch_size": 1024},
}
_RATES: Mapping[str, float] = {"ppo": 5e-4, "a2c": 7e-4, "trpo": 1e-3}  # initial learning rates
_LAST_RATE: Final = 0.05  # least learning rate, as a share of the initial one
_WIDEST: Final = 4096  # greatest width of a hidden layer


@validated
class TrainingConfig:
    """The configuration of a training."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    env: str = "intersection-straight"  # functional scenario
    algo: str = "ppo"  # one of `ALGORITHMS`
    # number of decisions over all sub-environments, rounded up to whole batches of experience
    steps: Annotated[int, between(1, 10**12)] = 8_000_000
    # random seed. The same seed gives the same policy on the same kind of processor.
    seed: Annotated[int, between(0, 2**63 - 1)] = 0
    envs: Annotated[int, between(1, MOST_ENVS)] = 64  # number of sub-environments in lock-step
    stage: Annotated[int, between(1, 10**12)] = 500_000  # number of steps between two saved models
    layers: tuple[int, ...] = (128, 128)  # widths of the network's hidden layers

    def __post_init__(self) -> None:
        if self.env not in FUNCTIONAL_SCENARIOS:
            raise _not_trainable(self.env)
        if self.algo not in ALGORITHMS:
            raise unknown_name("algorithm", self.algo, ALGORITHMS)
        if not self.layers or not all(1 <= width <= _WIDEST for width in self.layers):
            raise InputError(f"layers {self.layers} must be at least one width, each between 1 and {_WIDEST}")

    @property
    def n_stages(self) -> int:
        """Number of stages, of which the last may be shorter."""
        return -(-self.steps // self.stage)  # rounded up

    def to_yaml(self) -> str:
        """Return the whole configuration as YAML."""
        return yaml.safe_dump({**asdict(self), "layers": list(self.layers)}, sort_keys=False)


def _not_trainable(env: str) -> InputError:
    """Return the error for an environment whose policies are not trained by this module."""
    if env.removeprefix(f"{NAMESPACE}/") in HIGHWAY_ENV:
        return InputError(
            f"Policies for {env} are trained by Stable-Baselines3 itself, for example on HighwayVecEnv, which is "
            f"compiled (docs/highway-env.md): this trains on {', '.join(FUNCTIONAL_SCENARIOS)}"
        )
    return unknown_name("functional scenario", env, FUNCTIONAL_SCENARIOS)


@dataclass(frozen=True)
class Learned:
    """Progress of a training."""

    steps: int  # number of steps so far
    reward: float = 0.0  # mean reward of the latest episodes
    ends: Mapping[str, float] = field(default_factory=dict)  # shares of the latest episodes by kind of end


def train(config: TrainingConfig, folder: Path, observe: Callable[[Learned], None]) -> Path:
    """Train a policy; `observe` gets the progress after each batch of experience.

    The folder has models, logs and the final network. A training is resumed from the last model in it.

    Returns:
        The file of the network, for `behavexplor.ads.learned.network_file.read_network`.

    Raises:
        InputError: if the environment does not support training, or the last model cannot be read.
    """
    torch.set_num_threads(1)  # more threads change the last bits
    venv = learning_env(config.env, config.envs)
    make_folder(folder, MODELS)
    first, model = _last_model(folder, config, venv)
    model.set_logger(configure(log_folder(folder, f"stage-{first + 1:04d}"), log_formats()))
    reporter = TrainingReporter(observe)
    try:
        for stage in range(first, config.n_stages):
            rate = _RATES[config.algo] * max(1 - stage / config.n_stages, _LAST_RATE)
            begin_stage(model, venv, (config.seed, stage), rate)
            steps = min(config.stage, config.steps - stage * config.stage)
            model.learn(steps, callback=reporter, reset_num_timesteps=False)
            save_model(model, folder / MODELS / f"stage-{stage + 1:04d}.pt")
    finally:
        model.logger.close()
        venv.close()
    write_network(folder / NETWORK, trained_network(model.policy))
    return folder / NETWORK


def save_model(model: BaseAlgorithm, path: Path) -> None:
    """Save the learned state of a model atomically."""
    learned = {
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "steps": model.num_timesteps,
        "updates": model._n_updates,  # noqa: SLF001 - the logs show it
    }
    write_saved(path, partial(torch.save, learned))


def restore_model(model: BaseAlgorithm, path: Path, otherwise: str) -> None:
    """Load a saved state into a new model. Only numbers are read from the file, never code.

    `otherwise` says what a user can do if the file cannot be read.

    Raises:
        InputError: if the file is damaged or belongs to another model.
    """
    try:
        data = read_file(path)  # torch would wait for a pipe, and read a file of any size
        learned = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
        model.policy.load_state_dict(learned["policy"])
        model.policy.optimizer.load_state_dict(learned["optimizer"])
        model.num_timesteps = int(learned["steps"])
        model._n_updates = int(learned["updates"])  # noqa: SLF001 - the logs show it
    except Exception as error:  # torch can raise anything for a damaged file
        first = str(error).split("\n", maxsplit=1)[0]
        raise InputError(f"Cannot resume from {path}: {first}; {otherwise}") from error


def load_layers(model: BaseAlgorithm, layers: Layers) -> None:
    """Give the actor of a model the weights and biases of a network."""
    for part, (weights, bias) in zip(dense_layers(model.policy), layers, strict=True):
        part.weight.data = torch.as_tensor(weights, dtype=torch.float32)
        part.bias.data = torch.as_tensor(bias, dtype=torch.float32)


def learning_env(env: str, num_envs: int = 64) -> LearningVecEnv:
    """Return the vector environment in which policies of this package are trained, for Stable-Baselines3.

    Its observations are the features of `behavexplor.ads.learned.observation`, and its actions are the accelerations
    and lane choices of `behavexplor.ads.learned.deciding`.

    Args:
        env: functional scenario, such as "lane-change".
        num_envs: number of sub-environments in lock-step.

    Raises:
        InputError: if there is no functional scenario of that name.
    """
    if env not in FUNCTIONAL_SCENARIOS:
        raise _not_trainable(env)
    settings = {"observation": dict(OBSERVATION), "action": dict(ACTION), "policy_frequency": POLICY_FREQUENCY}
    envs: Any = gymnasium.make_vec(
        environment_id(env),
        num_envs=num_envs,
        vectorization_mode="vector_entry_point",
        autoreset_mode="SameStep",
        config=settings,
    )
    return LearningVecEnv(DrivingVecEnv(envs), envs.logical.roadmap)


def write_model(network: TrainedNetwork, env: str, path: Path) -> None:
    """Write a network, trained in the functional scenario `env`, as a model of Stable-Baselines3 with a new critic.

    The model is a ".zip"; the file that describes it is written beside it. `PPO.load(path, env=learning_env(...))` goes
    on training the model, and `--ads` drives it as the network.

    Raises:
        InputError: if the network is none of this package's policies, or the file cannot be written.
    """
    venv = learning_env(env, 1)
    LearnedDriver(venv.roadmap, network)  # checks the shapes
    layers = tuple(len(bias) for _, bias in network.layers[:-1])
    model = new_model(TrainingConfig(env=env, envs=1, layers=layers), venv)
    load_layers(model, network.layers)
    venv.close()
    with writing(path):
        make_folder(path.parent)
        write_saved(path, model.save)
        write_durably(path.with_suffix(".yaml"), yaml.safe_dump({"env": env, "decision": network.rule}))


def new_model(config: TrainingConfig, venv: LearningVecEnv) -> OnPolicyAlgorithm:
    """Return an untrained model, whose weights are drawn by the configuration's seed."""
    algorithm: Any = ALGORITHMS[config.algo]
    settings = dict(_SETTINGS[config.algo])
    if "batch_size" in settings:
        settings["batch_size"] = min(settings["batch_size"], settings["n_steps"] * config.envs)
    network = {"net_arch": list(config.layers), "activation_fn": torch.nn.Tanh}
    set_random_seed(config.seed % 2**32)
    model: OnPolicyAlgorithm = algorithm("MlpPolicy", venv, policy_kwargs=network, device="cpu", **settings)
    return model


def _last_model(folder: Path, config: TrainingConfig, venv: LearningVecEnv) -> tuple[int, OnPolicyAlgorithm]:
    """Return the number of finished stages and the model after them; a new model before the first stage."""
    model = new_model(config, venv)
    saved = sorted(path for path in (folder / MODELS).glob("stage-*.pt") if re.fullmatch(r"stage-\d{4,}", path.stem))
    if not saved:
        return 0, model
    restore_model(model, saved[-1], "delete it to resume from the model before it")
    return int(saved[-1].stem.removeprefix("stage-")), model


def begin_stage(model: BaseAlgorithm, venv: VecEnv, seed: Sequence[int], rate: float) -> None:
    """Set new episodes, random generators and the learning rate. `seed` is that of the stage, such as (7, 2)."""
    networks, episodes = np.random.SeedSequence(seed).generate_state(2)
    set_random_seed(int(networks))
    venv.seed(int(episodes))
    model.action_space.seed(int(networks))
    model._last_obs = None  # noqa: SLF001 - so that `learn` resets the environment
    model.learning_rate = rate
    model._setup_lr_schedule()  # noqa: SLF001 - the only way to change the learning rate of a model


class TrainingReporter(BaseCallback):
    """Callback that reports rewards and ends of the latest episodes after each batch of experience, and logs them."""

    def __init__(self, observe: Callable[[Learned], None]) -> None:
        super().__init__()
        self._observe = observe
        self._ends: deque[str] = deque(maxlen=EPISODES)
        self._rewards: deque[float] = deque(maxlen=EPISODES)
        self._sums: Floats = np.zeros(0)  # rewards of the present episodes so far, shape (num_envs,)

    def _on_training_start(self) -> None:
        self._sums = np.zeros(self.training_env.num_envs)

    def _on_step(self) -> bool:
        self._sums += self.locals["rewards"]
        for i in np.flatnonzero(self.locals["dones"]):
            self._ends.append(self.locals["infos"][i]["end"])
            self._rewards.append(float(self._sums[i]))
            self._sums[i] = 0.0
        return True

    def _on_rollout_end(self) -> None:
        shares = {end: count / len(self._ends) for end, count in sorted(Counter(self._ends).items())}
        reward = float(np.mean(self._rewards)) if self._rewards else 0.0
        for name, value in {"reward": reward, **shares}.items():
            self.logger.record(f"rollout/{name}", value)
        self._observe(Learned(self.num_timesteps, reward, shares))


def log_folder(folder: Path, name: str) -> str:
    """Return a folder for the logs of a training, which is created if it does not exist.

    Raises:
        OSError: if it or a file in it is a symbolic link, through which Stable-Baselines3 would write.
    """
    logs = make_folder(folder, LOGS, name)
    for file in logs.iterdir():  # of an earlier attempt
        check_file(file)
    return str(logs)


def log_formats() -> list[str]:
    """Return the formats of the logs, with TensorBoard's if it is installed."""
    return ["csv", "tensorboard"] if find_spec("tensorboard") else ["csv"]
