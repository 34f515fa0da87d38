"""Malformed input ends with exit code 2 and one sentence: no traceback, no hang, no memory eaten."""

import json
from collections import Counter

import numpy as np
import pytest

from behavexplor.campaign.config import CampaignConfig
from behavexplor.commands import BAD_INPUT, OK
from behavexplor.data.scenario import parse_scenario
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError
from behavexplor.execution.simulation import Simulation
from tests import malformed
from tests.campaign.test_store import TRACES
from tests.malformed import is_sentence, limited, refuse

LOGICAL = Simulation("lane-follow", "constant").logical


def of_scenario(rng, tmp_path, capfd):
    text = malformed.scenario_text(rng, LOGICAL.sample(rng))
    try:
        LOGICAL.check(parse_scenario(text.decode(errors="replace")))
    except InputError as error:
        assert is_sentence(str(error))
        return BAD_INPUT
    return OK


def of_trace(rng, tmp_path, capfd):
    data = malformed.scrambled(TRACES[0], rng) if rng.random() < 0.95 else malformed.network(rng)
    try:
        Trace.from_bytes(data)
    except InputError as error:
        assert is_sentence(str(error))
        return BAD_INPUT
    return OK


def of_config_file(rng, tmp_path, capfd):
    path = malformed.write(tmp_path / "config.yaml", malformed.config_text(rng))
    return refuse(capfd, "fuzz", "--config", path, "--workers", "0", "--seed", "-1")


def of_run(rng, tmp_path, capfd):
    config = CampaignConfig(env="lane-follow", ads="constant", method="uniform", budget="12", seed=3).to_yaml()
    malformed.make_run(tmp_path / "whole", config)
    run = malformed.broken_run(tmp_path / "whole", tmp_path / "run", rng)
    command = [["records"], ["replay"], ["fuzz", "--workers", "0", "--quiet", "--resume"]][int(rng.integers(3))]
    more = [str(rng.integers(-1, 14)), "--out", tmp_path / "pictures"] if command == ["replay"] else []
    return refuse(capfd, *command, run, *more, accepted=(OK, 1), sentences=3)


def of_network(rng, tmp_path, capfd):
    path = malformed.write(tmp_path / "policy.npz", malformed.network(rng))
    return refuse(
        capfd,
        "fuzz",
        "--workers",
        "0",
        "--unconfined",
        "--ads",
        path,
        "--env",
        "lane-follow",
        "--out",
        tmp_path / "run",
    )


def of_model(rng, tmp_path, capfd):
    path = malformed.write(tmp_path / "policy.zip", malformed.model(rng))
    return refuse(
        capfd,
        "fuzz",
        "--workers",
        "0",
        "--unconfined",
        "--ads",
        path,
        "--env",
        "lane-follow",
        "--out",
        tmp_path / "run",
    )


def of_zoo(rng, tmp_path, capfd):
    folder = malformed.zoo(tmp_path / "zoo", rng)
    return refuse(
        capfd,
        "fuzz",
        "--workers",
        "0",
        "--unconfined",
        "--ads",
        folder,
        "--env",
        "lane-follow",
        "--out",
        tmp_path / "run",
    )


def of_flags(rng, tmp_path, capfd):
    return refuse(capfd, "fuzz", *malformed.flags(rng), "--seed", "-1")


KINDS = {  # how many of each in the short test
    of_scenario: 80,
    of_trace: 60,
    of_config_file: 60,
    of_run: 30,
    of_network: 20,
    of_model: 20,
    of_zoo: 15,
    of_flags: 30,
}
FACTOR = {of_scenario: 45, of_trace: 40, of_config_file: 40, of_run: 10, of_flags: 30}  # and more in the long one


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_malformed_input_is_refused_in_one_sentence(kind, tmp_path, capfd, monkeypatch):
    attack(kind, range(KINDS[kind]), tmp_path, capfd, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_much_malformed_input_is_refused_in_one_sentence(kind, tmp_path, capfd, monkeypatch):
    count = KINDS[kind] * FACTOR.get(kind, 10)
    codes = attack(kind, range(1000, 1000 + count), tmp_path, capfd, monkeypatch)
    with capfd.disabled():
        print(json.dumps({kind.__name__: codes}))  # noqa: T201 - the figures of docs/robustness.md


def attack(kind, seeds, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    codes = Counter()
    for seed in seeds:
        folder = tmp_path / str(seed)
        folder.mkdir()
        try:
            with limited():
                codes[kind(np.random.default_rng(seed), folder, capfd)] += 1
        except BaseException as error:
            error.add_note(f"{kind.__name__} with seed {seed}")
            raise
    assert codes[BAD_INPUT] >= 0.2 * len(seeds)
    return codes
