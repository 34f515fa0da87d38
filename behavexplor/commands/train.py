"""`behavexplor train`: train a driving policy."""

import shlex
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import yaml

from behavexplor.campaign.config import RUNS
from behavexplor.commands import INTERRUPTED, OK, program
from behavexplor.commands.display import Meter
from behavexplor.commands.rate_table import rates_table
from behavexplor.commands.shared_flags import Switch, check_unchanged, flag
from behavexplor.commands.trainings import begin_training, progress_line, resumed_config
from behavexplor.commands.wording import say
from behavexplor.data.durable import write_durably
from behavexplor.data.target import Target
from behavexplor.errors import InputError, missing_library
from behavexplor.evaluation import Evaluation, estimate_rates, start_judge
from behavexplor.execution.simulation import logical_scenario

if TYPE_CHECKING:
    from behavexplor.training import TrainingConfig

CARD = "policy.yaml"  # file beside the network
EVALUATED = 1000  # number of scenarios in the final evaluation
EVALUATION_SEED = 0


def train(
    *,
    env: Annotated[str | None, flag("NAME", "intersection-straight")] = None,
    algo: Annotated[str | None, flag("NAME", "ppo")] = None,
    steps: Annotated[int | None, flag("N", 8_000_000)] = None,
    seed: Annotated[int | None, flag("N", 0)] = None,
    envs: Annotated[int | None, flag("N", 64)] = None,
    out: Annotated[Path | None, flag("FOLDER", "runs/ENV-ALGO-SEED")] = None,
    resume: Annotated[Path | None, flag("FOLDER", None)] = None,
    quiet: Switch = False,
) -> int:
    """Train a driving policy on one functional scenario, and evaluate it.

    Args:
        env: Functional scenario.
        algo: Algorithm: "ppo", "a2c" or "trpo".
        steps: Number of training steps, each 0.2 s of driving.
        seed: Random seed. The same seed gives the same policy on the same kind of machine.
        envs: Number of environments in lock-step.
        out: Folder for models and logs, new or empty.
        resume: Resume the training in this folder.
        quiet: Print only the result.
    """
    try:
        from behavexplor import training  # noqa: PLC0415 - torch is heavy, and need not be installed
    except ModuleNotFoundError as error:
        raise missing_library("Training", error.name, "rl") from None
    flags = {"env": env, "algo": algo, "steps": steps, "seed": seed, "envs": envs}
    given: dict[str, Any] = {name: value for name, value in flags.items() if value is not None}
    if resume:
        if out:
            raise InputError("--out cannot be given with --resume")
        folder, config = resume, resumed_config(training.TrainingConfig, resume / training.CONFIG, "training")
        check_unchanged(given, config, "training")
    else:
        config = training.TrainingConfig(**given)
        folder = out or RUNS / f"{config.env}-{config.algo}-{config.seed}"
        begin_training(folder, training.CONFIG, config)
    try:
        with Meter(sys.stderr, config.steps, "steps", quiet=quiet) as meter:
            network = training.train(config, folder, lambda learned: meter.show(learned.steps, progress_line(learned)))
        with Meter(sys.stderr, EVALUATED, "scenarios", quiet=quiet) as meter:
            # without worker processes, as a network of plain numbers runs no code of others
            executor = start_judge(Target(config.env, str(network)), 0)
            found = estimate_rates(executor, logical_scenario(config.env), EVALUATED, EVALUATION_SEED, meter.show)
    except KeyboardInterrupt:
        say(f"Interrupted; resume with: {program()} train --resume {shlex.quote(str(folder))}", file=sys.stderr)
        return INTERRUPTED
    write_durably(folder / CARD, _card(config, found))
    say(rates_table(config.env, {network.name: found}))
    name = shlex.quote(str(network))
    say(f"The policy is in {name}\nSearch for its failures:\n{program()} fuzz --env {config.env} --ads {name}")
    return OK


def _card(config: "TrainingConfig", found: Evaluation) -> str:
    """Return the model card of a policy: how it was trained, and how well it drives."""
    command = ["behavexplor", "train", "--env", config.env, "--algo", config.algo, "--steps", str(config.steps)]
    rates = {name: round(found.rate(name), 4) for name in found.counts}
    card: dict[str, Any] = {
        "trained_by": shlex.join([*command, "--seed", str(config.seed), "--envs", str(config.envs)]),
        "training": {**asdict(config), "layers": list(config.layers)},
        "evaluation": {"scenarios": found.n, "seed": EVALUATION_SEED, "rates": rates},
    }
    return yaml.safe_dump(card, sort_keys=False, width=120)
