"""`behavexplor inspect`: what the file of a policy holds, whether it loads, and where it drives."""

import hashlib
import shlex
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from behavexplor import FUNCTIONAL_SCENARIOS
from behavexplor.ads.learned.network_file import read_network
from behavexplor.ads.learned.shipped import PREFIX, policy_file
from behavexplor.ads.loading import load_ads
from behavexplor.ads.sb3.archive import Archive, read_archive
from behavexplor.ads.sb3.description import WEIGHTS, describe, files_of_model, find_model, named_env
from behavexplor.ads.sb3.highway_fit import how_to_fit
from behavexplor.ads.sb3.inert import Inert, Name
from behavexplor.ads.weights.layers import ActingNetwork, chosen, networks_in, reason_against, unused
from behavexplor.ads.weights.tensors import TensorFile, read_tensors, tensors_in
from behavexplor.commands import OK, program
from behavexplor.commands.outputs import JsonFile, check_outputs, write_json
from behavexplor.commands.shared_flags import GivenActivation, Trust, read_env_config
from behavexplor.commands.wording import counted, hanging, say
from behavexplor.data.drawn_scenario import DECLARATIONS
from behavexplor.data.untrusted import read_file
from behavexplor.envs.making import highway_ids
from behavexplor.errors import InputError, sentence
from behavexplor.execution.evaluator import collected_notices
from behavexplor.execution.simulation import Simulation, brief_space, seen_in

_LABEL: Final = 14  # width of the first column
# The module of a model's policy names its algorithm. TRPO, PPO and A2C have the same policies: the first name in
# `_OF_NUMBERS` that the file has tells which of them it is.
_OF_MODULES: Final[Mapping[str, str]] = {
    "dqn": "DQN",
    "qrdqn": "QR-DQN",
    "sac": "SAC",
    "td3": "TD3 or DDPG",
    "tqc": "TQC",
    "crossq": "CrossQ",
    "ars": "ARS",
    "maskable": "MaskablePPO",
    "ppo_mask": "MaskablePPO",
    "recurrent": "RecurrentPPO",
    "ppo_recurrent": "RecurrentPPO",
}
_OF_NUMBERS: Final[Mapping[str, str]] = {"cg_max_steps": "TRPO", "n_epochs": "PPO", "gae_lambda": "A2C"}
_MOST: Final = 8  # networks, unused tensors or suspicions that are listed


def inspect(
    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")],
    *,
    activation: GivenActivation = None,
    env_config: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None,
    trust: Trust = (),
    json_file: JsonFile = None,
) -> int:
    """Show what the file of a policy holds, whether it loads, where it can drive, and the command for that.

    No code of the file is executed.

    Args:
        policy: File or folder of a policy, or learned:NAME.
        activation: Function between the layers of a file of weights, such as relu.
        env_config: YAML file with the configuration of the environment, as for fuzz.
        trust: Allow the policy file with this digest ("sha256:...") to execute code.
        json_file: Also write all of this to this JSON file; - is standard output.
    """
    output, found = check_outputs(json_file), contents_of(policy)
    config = None if env_config is None else read_env_config(env_config)
    with warnings.catch_warnings(), collected_notices():
        driving = _driving(policy, config, trust, activation)
    flags = f" --activation {activation}" if activation else ""
    flags += f" --env-config {shlex.quote(str(env_config))}" if env_config else ""
    flags += "".join(f" --trust {digest}" for digest in trust)
    fits = driving.pop("fits")
    env = next((one for one in ("highway-fast-v0", *fits) if one in fits), None)
    command = f"{program()} fuzz --env {shlex.quote(env)} --ads {shlex.quote(policy)}{flags}" if env else None
    given = {"activation": f"{activation}, as --activation says"} if activation else {}
    known = {"file": str(found.path), **found.facts, **given, **driving}
    for label, text in known.items():
        beside = hanging(f"{label:{_LABEL}}", text)
        say(f"{label}\n{text}" if label == "digest" else beside, file=output)  # so that it can be copied
    if command is not None:
        say(f"Search for its failures:\n{command}", file=output)
    write_json(json_file, {**known, "fits": fits, "command": command})
    return OK


def _driving(policy: str, config: dict[str, Any] | None, trust: tuple[str, ...], activation: Any) -> dict[str, Any]:
    """Return whether a policy loads and where it drives, in words, and the environments as a list under "fits"."""
    try:
        trained = named_env(None, policy)
        if trained is not None:
            ads = Simulation(trained, policy, trust, config, activation=activation).ads
            place = {"drives in": f"{trained}, which a file beside it names", "fits": [trained]}
            return {"loads": "yes", **_spaces(ads), **place}
        ads = load_ads(policy, None, trust, activation)
    except InputError as error:
        return {"loads": f"no: {error}", "fits": []}
    seen: dict[str, Any] = {}  # by environment, the driver as it sees it; under "", the last one that it does not fit
    refused: dict[str, None] = {}  # messages of the environments that refuse it, each once and in order
    for env in (*FUNCTIONAL_SCENARIOS, *highway_ids()):
        try:
            driver, fits = seen_in(env, ads, config or {})
        except InputError as error:
            refused[str(error)] = None
        else:
            seen[env if fits else ""] = driver
    return {"loads": "yes", **_place(seen, list(refused))}


def _place(seen: dict[str, Any], refused: list[str]) -> dict[str, Any]:
    """Return where a policy drives."""
    fits = [env for env in seen if env]
    if fits:
        is_said = any(hasattr(seen[fits[0]], key) for key in DECLARATIONS)
        how = "as the files beside it configure them" if is_said else "in their own configurations"
        return {**_spaces(seen[fits[0]]), "drives in": f"{', '.join(fits)}, {how}", "fits": fits}
    if refused:
        return {"drives in": f"no environment as it is: {refused[0]}", "fits": []}
    spaces = seen[""].observation_space, seen[""].action_space
    return {**_spaces(seen[""]), "drives in": f"no environment as it is. {how_to_fit(*spaces)}", "fits": []}


def _spaces(ads: Any) -> dict[str, str]:
    if not hasattr(ads, "observation_space"):  # a network of `train`, which sees features of its own
        return {}
    said = {"its view": ads.said} if getattr(ads, "said", "") else {}
    return {"observations": brief_space(ads.observation_space), "actions": brief_space(ads.action_space), **said}


@dataclass(frozen=True)
class Contents:
    """What the file of a policy holds."""

    path: Path  # path of the file
    facts: Mapping[str, str]  # what is known, in words, by what it is about


def contents_of(policy: str) -> Contents:
    """Read a policy's file, or that in a folder of rl-zoo3.

    Raises:
        InputError: if it is no such file, or cannot be read.
    """
    if policy.startswith(PREFIX) or policy.endswith(".npz"):
        path = policy_file(policy)
        network = read_network(path)
        widths = [network.layers[0][0].shape[1], *(len(bias) for _, bias in network.layers)]
        known = {"holds": "a network of `train`", "layers": "-".join(map(str, widths)), "decides by": network.rule}
        return Contents(path, {**known, "digest": f"sha256:{hashlib.sha256(read_file(path)).hexdigest()}"})
    path = find_model(Path(policy))
    facts = _of_weights(read_tensors(path)) if path.suffix in WEIGHTS else _of_archive(read_archive(path))
    beside = [file.name for file in files_of_model(str(path))[1:]]
    return Contents(path, {**facts, "settings": ", ".join(beside) or "none beside it"})


def _of_archive(archive: Archive) -> dict[str, str]:
    """Return what the file of a model of Stable-Baselines3 holds."""
    numbers, rate = archive.numbers, archive.numbers.get("learning_rate")
    try:
        layers = _layers(tensors_in(archive.path, archive.weights, archive.digest), None)
        layers += _function_between(archive) if "-" in layers else ""
    except Exception as error:  # of many kinds, for damaged files
        layers = f"unknown: {sentence(str(error))}"
    return {
        "holds": "a model of Stable-Baselines3 or sb3-contrib",
        "algorithm": _algorithm(archive),
        "layers": layers,
        "trained for": f"{numbers.get('num_timesteps', '?')} decisions (n_envs: {numbers.get('n_envs', '?')})",
        "schedule": f"learning rate {rate}, constant" if rate is not None else "learning rate by a function",
        "versions": ", ".join(archive.versions) or "not in the file",
        "digest": archive.digest,
        **({"unusual": ". ".join(archive.suspicions[:_MOST])} if archive.suspicions else {}),
    }


def _algorithm(archive: Archive) -> str:
    policy = archive.settings.get("policy_class")
    if isinstance(policy, Inert):
        return "unknown, with a policy class of its own"
    parts = policy.name.split(".") if isinstance(policy, Name) else []
    known = next((_OF_MODULES[part] for part in parts if part in _OF_MODULES), None)
    numbered = (_OF_NUMBERS[name] for name in _OF_NUMBERS if name in archive.numbers)
    return f"{known or next(numbered, 'unknown')}, {parts[-1]}" if parts else "unknown"


def _function_between(archive: Archive) -> str:
    """Return the function between the layers, in words; empty if neither the file nor its algorithm tells it."""
    keywords = archive.settings.get("policy_kwargs")
    named = keywords.get("activation_fn") if isinstance(keywords, dict) else None
    if isinstance(named, Name):
        return f", {named.name.rpartition('.')[2]} between them"
    policy = archive.settings.get("policy_class")
    if named is not None or not isinstance(policy, Name):  # code of its own, which was not run
        return ""
    return ", Tanh between them" if "ActorCritic" in policy.name else ", ReLU between them"


def _of_weights(file: TensorFile) -> dict[str, str]:
    """Return what a file of weights holds."""
    said = describe(file.path)
    network = chosen(networks_in(file), said.network)
    numbers = sum(array.size for array in file.arrays.values())
    facts = {
        "holds": f"weights alone: {counted(len(file.arrays), 'tensor')} with {numbers} numbers",
        "layers": _layers(file, said.network),
        **({"network": network.name} if network is not None and network.name else {}),
        **({"convolutions": _kernels(network)} if network is not None and network.convolutions else {}),
        "activation": said.activation or "not in the file",
        **({"unused": ", ".join(rest[:_MOST])} if network is not None and (rest := unused(file, network)) else {}),
        "digest": file.digest,
    }
    return {**facts, **({"unusual": ". ".join(file.suspicions[:_MOST])} if file.suspicions else {})}


def _kernels(network: ActingNetwork) -> str:
    return ", ".join(f"{one.name} {one.weight.shape[2]}x{one.weight.shape[3]}" for one in network.convolutions)


def _layers(file: TensorFile, name: str | None) -> str:
    """Return the layers of the network that acts, or of all networks if it is not clear which one does."""
    networks = networks_in(file)
    network = chosen(networks, name)
    if network is not None:
        return str(network)
    return ", ".join(f"{one.name} {one}" for one in networks[:_MOST]) or reason_against(file)
