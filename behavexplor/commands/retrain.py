"""`behavexplor retrain`: train a policy further on the scenarios in which it fails."""

import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from behavexplor.ads.sb3.description import named_env
from behavexplor.campaign.campaign import ExecutionError
from behavexplor.campaign.config import RUNS, CampaignConfig
from behavexplor.campaign.provenance import Consent, agreed, own_digests, remember
from behavexplor.commands import EXECUTION_FAILED, INTERRUPTED, OK, execution_failed, program
from behavexplor.commands.config_flags import Shown, settings
from behavexplor.commands.display import Meter
from behavexplor.commands.plain_tables import grid, plain_text
from behavexplor.commands.shared_flags import Switch, Trust, check_unchanged, flag
from behavexplor.commands.trainings import begin_training, progress_line, resumed_config
from behavexplor.commands.wording import say, wrapped
from behavexplor.errors import InputError, missing_library, sentence
from behavexplor.repair.retraining_rounds import CONFIG, DivergedError, RetrainingConfig, Round, best

_SETTINGS = settings(
    RetrainingConfig,
    "env env_config traffic pool share rounds steps envs rate method budget validation seed",
    env=Shown(f"the policy's own, or {CampaignConfig.env}"),
    envs=Shown("the model's, or 64"),
    rate=Shown("the model's, or 2.5e-4"),
)


def retrain(
    policy: Annotated[str | None, tyro.conf.Positional, flag("POLICY", None)] = None,
    *,
    given: Annotated[dict[str, Any], _SETTINGS],
    out: Annotated[Path | None, flag("FOLDER", "runs/ENV-retrain-SEED")] = None,
    resume: Annotated[Path | None, flag("FOLDER", None)] = None,
    trust: Trust = (),
    quiet: Switch = False,
) -> int:
    """Train a policy further on a mixture of ordinary scenarios and those in which it fails, and keep the best round.

    The best round is chosen in validation scenarios. `compare` then shows in other scenarios what was fixed and broken.

    Args:
        policy: Model of Stable-Baselines3 (PPO, A2C, TRPO, DQN or QR-DQN), policy.npz of `train`, or learned:NAME.
        given: Settings of the retraining, see `behavexplor.repair.retraining_rounds.RetrainingConfig`.
        out: Folder for rounds and logs, new or empty.
        resume: Resume the retraining in this folder.
        trust: With --resume, allow the folder with this digest ("sha256:...") to execute code: that of its environment
            and of its search method.
        quiet: Print only the result.
    """
    try:
        from behavexplor.repair import retraining  # noqa: PLC0415 - torch is heavy, and need not be installed
    except ModuleNotFoundError as error:
        raise missing_library("Retraining", error.name, "rl") from None
    if resume:
        if policy or out:
            raise InputError("A policy and --out cannot be given with --resume")
        folder, config = resume, resumed_config(RetrainingConfig, resume / CONFIG, "retraining")
        check_unchanged(given, config, "retraining")
        names = tuple(value for value in given.values() if isinstance(value, str))  # what the user names is trusted
        agreed(replace(config.claim, place=folder / CONFIG), Consent(trust, names=names))
    else:
        if not policy:
            raise InputError("Give a policy to train further, such as model.zip or runs/lane-change-ppo-0/policy.npz")
        env = named_env(given.get("env"), policy) or CampaignConfig.env
        config = RetrainingConfig(**{**given, "env": env, "policy": policy})
        folder = out or RUNS / f"{config.env.rpartition(':')[2]}-retrain-{config.seed}"
        own = own_digests(config.claim)
        retraining.check(config)
        remember(own)
        begin_training(folder, CONFIG, config)
    return _run(config, folder, quiet=quiet)


def _run(config: RetrainingConfig, folder: Path, *, quiet: bool) -> int:
    """Retrain, and report every round."""
    from behavexplor.repair import retraining  # noqa: PLC0415 - see `retrain`

    def report(one: Round) -> None:
        if not quiet:
            say(f"round {one.number} of {config.rounds}: {_words(one)}", file=sys.stderr)

    made = retraining.policy_in(folder, config)
    name = shlex.quote(str(made))
    trains_critic = made.suffix == ".npz"
    total = config.steps * (config.rounds + trains_critic)
    try:
        with Meter(sys.stderr, total, "steps", quiet=quiet) as meter:
            rounds = retraining.retrain(
                config, folder, lambda learned: meter.show(learned.steps, progress_line(learned)), report
            )
    except KeyboardInterrupt:
        say(f"Interrupted; resume with: {program()} retrain --resume {shlex.quote(str(folder))}", file=sys.stderr)
        return INTERRUPTED
    except ExecutionError as error:
        return execution_failed(str(error))
    except DivergedError as error:
        say(f"{program()}: {sentence(str(error))}\nThe best policy until then is in {name}.", file=sys.stderr)
        return EXECUTION_FAILED
    say(_table(rounds))
    chosen = best(rounds).number
    if chosen == 0:
        say(wrapped(f"No round was better than the policy as it was given, of which {name} is a copy."))
        return OK
    say(f"\nThe policy of round {chosen} is in {name}\nWhat it fixed and what it broke:")
    say(comparison(config, made))
    return OK


def comparison(config: RetrainingConfig, made: Path) -> str:
    """Return the command that compares the policy as it was given with another one, where it was trained."""
    words = ["compare", config.policy, str(made), "--env", config.env]
    words += ["--traffic", config.traffic] if config.traffic != RetrainingConfig.traffic else []
    words += ["--env-config", "FILE"] if config.env_config else []  # the file that was given is not known here
    return f"{program()} {shlex.join(words)}"


def _words(one: Round) -> str:
    found = "" if one.found is None else f"; {one.found} failures found"
    pool = f"; {one.pool} scenarios in the pool" if one.pool else ""
    return f"{one.at_fault:.1%} failures at fault{found}{pool}"


def _table(rounds: list[Round]) -> str:
    """Return the results of all rounds. Fixed and broken are counted against the policy as it was given."""
    columns = ("round", "steps", "at fault", "fixed", "broken", "passed", "found", "pool")
    made = grid(*columns, numbers=columns)
    first = rounds[0]
    for one in rounds:
        cells = (one.number, one.steps, f"{one.at_fault:.1%}", one.fixed(first), one.broken(first))
        found = "" if one.found is None else one.found
        made.add_row(*map(str, (*cells, f"{one.passed / one.validated:.1%}", found, one.pool)))
    return plain_text(made)
