"""`behavexplor zip`: write a trained network as a model of Stable-Baselines3."""

import shlex
from pathlib import Path
from typing import Annotated

import tyro

from behavexplor.ads.learned.network_file import read_network
from behavexplor.ads.learned.shipped import policy_file
from behavexplor.ads.sb3.description import env_in_card
from behavexplor.commands import OK, program
from behavexplor.commands.shared_flags import flag
from behavexplor.commands.wording import say
from behavexplor.errors import InputError, missing_library


def zip(  # noqa: A001 - the command's name
    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")],
    env: Annotated[str | None, flag("NAME", "that of its training")] = None,
) -> int:
    """Write a trained network as a model of Stable-Baselines3, to train it further or to evaluate it in a script.

    Its environment is behavexplor.sb3.learning_env(NAME). Its critic is new, because the network has none.

    Args:
        policy: Network that `train` made (policy.npz), or learned:NAME.
        out: New file for the model, which ends with .zip. A YAML file beside it describes it for --ads.
        env: Functional scenario of the network.
    """
    path = policy_file(policy)
    if path.suffix != ".npz":
        raise InputError(f"{policy} is no network of `train`: give a file policy.npz, or learned:NAME")
    if out.suffix != ".zip":
        raise InputError(f"--out {out} must end with .zip")
    for file in (out, out.with_suffix(".yaml")):
        if file.exists():
            raise InputError(f"{file} is there already, and is kept: name another file for --out")
    network = read_network(path)
    trained_in = env or env_in_card(path)
    if trained_in is None:
        raise InputError(f"No file beside {path} says in which functional scenario it was trained: give --env")
    try:
        from behavexplor.training import write_model  # noqa: PLC0415 - torch is heavy, and need not be installed
    except ModuleNotFoundError as error:
        raise missing_library("A model of Stable-Baselines3", error.name, "rl") from None
    write_model(network, trained_in, out)
    command = f"{program()} fuzz --env {shlex.quote(trained_in)} --ads {shlex.quote(str(out))}"
    say(f"The model is in {out}\nIt drives as {policy}:\n{command}")
    return OK
