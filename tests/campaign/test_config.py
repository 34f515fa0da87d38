"""Configurations: one sentence for whatever is wrong, and a file that makes the same campaign again."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from behavexplor.campaign.config import (
    CONFIG,
    RUNS,
    Budget,
    CampaignConfig,
    campaign_config,
    check_said_twice,
    checked,
    point_to_latest,
    read_config,
    run_folder,
    stored_config,
)
from behavexplor.errors import InputError
from behavexplor.fuzz.methods import METHODS, load_method

PRESETS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))


@pytest.mark.parametrize(
    ("text", "budget"),
    [
        ("750", Budget(executions=750)),
        ("90s", Budget(seconds=90)),
        ("30m", Budget(seconds=1800)),
        ("1h30m", Budget(seconds=5400)),
        ("0.5h", Budget(seconds=1800)),
    ],
)
def test_budgets(text, budget):
    assert Budget.parse(text) == budget


@pytest.mark.parametrize("text", ["", "0", "-3", "0m", "ten", "30x", "m", "1.5", "9" * 20, "30m1h", "9" * 400 + "h"])
def test_budgets_that_are_none(text):
    with pytest.raises(InputError, match="neither a number of executions"):
        Budget.parse(text)


@pytest.mark.parametrize("name", ["options", "env_config"])
def test_a_value_that_cannot_be_stored_is_named(name):
    with pytest.raises(InputError, match=r"cannot be stored: .*3.* is not plain data"):
        CampaignConfig(**{name: {"patience": np.int64(3)}}).to_yaml()


@pytest.mark.parametrize("values", [{"seed": 0, "batch": 1}, {"seed": 2**63 - 1, "batch": 10_000}])
def test_limits_are_allowed_themselves(values):
    assert campaign_config(values).stated().items() >= values.items()


@given(st.builds(CampaignConfig, seed=st.integers(0, 2**63 - 1), batch=st.integers(1, 100), budget=st.just("30m")))
def test_yaml_makes_the_same_campaign(config):
    assert campaign_config(yaml.safe_load(config.to_yaml())) == config


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"enw": "x"}, "Unknown key of the configuration 'enw': did you mean 'env'?"),
        ({"seed": "many"}, "seed of the configuration"),
        ({"seed": -1}, "The seed -1"),
        ({"seed": 2**63}, "The seed 9223372036854775808 must be a whole number from 0 to 2^63 - 1"),
        ({"batch": 0}, "The batch 0"),
        ({"batch": 10_001}, "The batch 10001 must lie between 1 and 10000"),
        ({"budget": "soon"}, "The budget 'soon'"),
        ({"options": 3}, "options of the configuration"),
    ],
)
def test_wrong_values_are_named(values, message):
    with pytest.raises(InputError) as error:
        campaign_config(values)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("path", PRESETS, ids=lambda path: path.stem)
def test_presets_are_campaigns(path):
    values = read_config(path.stem)
    assert values == read_config(str(path))
    config = campaign_config(values)
    checked(load_method(config.method).Options, config.options, "options")


@pytest.mark.parametrize("name", METHODS)
def test_unknown_options_are_refused(name):
    with pytest.raises(InputError, match="'widnow'"):
        checked(load_method(name).Options, {"widnow": 5}, f"options of {name}")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"miner": {"widnow": 5}},
            "Unknown key of the miner of the options of behavexplor 'widnow': did you mean 'window'",
        ),
        ({"assessment": {"retreta": 5}}, "did you mean 'retreat'"),
        ({"miner": 5}, "miner of the options of behavexplor"),
        ({"selection": "energetic"}, "selection of the options of behavexplor"),
        ({"assessment": {"retreat": -1.0}}, "retreat: must be a number from 0 to 100000"),
    ],
)
def test_wrong_options_are_named_however_deep(options, message):
    with pytest.raises(InputError) as error:
        checked(load_method("behavexplor").Options, options, "options of behavexplor")
    assert message in str(error.value)


def test_missing_files_name_the_presets():
    with pytest.raises(InputError, match="did you mean 'paper'"):
        read_config("papr")


@pytest.mark.parametrize(
    "text", ["a: [", "- 1\n- 2", "3", "? [a]\n: b", "\x00", "!!python/object:os.system {}", "1: 2"]
)
def test_files_that_hold_no_configuration(tmp_path, text):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_config(str(path))
    assert "\n" not in str(error.value)


def test_an_empty_file_is_the_defaults(tmp_path):
    (tmp_path / "c.yaml").write_text("# nothing\n")
    assert campaign_config(read_config(str(tmp_path / "c.yaml"))) == CampaignConfig()


def test_a_huge_file_is_not_read(tmp_path):
    (tmp_path / "c.yaml").write_text("a: " + "x" * 200_000)
    with pytest.raises(InputError, match="more than 100000 bytes"):
        read_config(str(tmp_path / "c.yaml"))


@settings(max_examples=200)
@given(st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(data)
    try:
        campaign_config(read_config(str(path)))
    except InputError as error:
        assert "\n" not in str(error)


DIGESTS = [f"sha256:{digit * 64}" for digit in "12"]


@pytest.mark.parametrize(
    ("values", "given_too", "words"),
    [
        ({"trust": DIGESTS}, {"trust": DIGESTS}, ""),
        ({"trust": DIGESTS}, {"trust": DIGESTS[:1]}, f"trusts {DIGESTS[1]}, .*: add --trust {DIGESTS[1]}"),
        ({"trust": tuple(DIGESTS)}, {}, f"trusts {DIGESTS[0]}"),
        (yaml.safe_load(f"trust: !!set {{'{DIGESTS[0]}'}}"), {}, f"trusts {DIGESTS[0]}"),
        ({"unconfined": True}, {"unconfined": False}, "says `unconfined`"),
        ({"unconfined": True}, {}, "says `unconfined`, .*: add --unconfined"),
        ({"unconfined": True}, {"unconfined": True}, ""),
        ({"unconfined": False, "trust": []}, {}, ""),
    ],
)
def test_trust_in_a_file_counts_only_if_it_is_said_on_the_command_line_too(values, given_too, words):
    with pytest.raises(InputError, match=words) if words else nullcontext():
        check_said_twice(values, given_too, "file.yaml")


def test_what_is_no_run_folder_is_told_how_to_name_one(tmp_path):
    with pytest.raises(InputError, match=r"its config.yaml is missing: restore the file or start a new run"):
        stored_config(tmp_path)
    inside = tmp_path / RUNS / "a" / "first"
    inside.mkdir(parents=True)
    (inside / CONFIG).write_text("")
    for outer in (tmp_path, tmp_path / RUNS / "a"):
        with pytest.raises(InputError, match=rf"is not a run folder, .*: name one that it holds, such as {inside}"):
            stored_config(outer)
    with pytest.raises(InputError, match="is empty, so the configuration of the run is lost"):
        stored_config(inside)


def test_every_campaign_has_a_folder_of_its_own(tmp_path):
    config = CampaignConfig(ads="models/best one.zip", env="behavexplor/lane-follow-v0")
    folders = set()
    for _ in range(4):
        folder = run_folder(config, tmp_path)
        folder.mkdir()
        folders.add(folder)
    assert len(folders) == 4
    assert {folder.parent for folder in folders} == {tmp_path}
    assert all(folder.name.startswith("lane-follow-v0-best-one-behavexplor-0-") for folder in folders)
    long = replace(config, ads=f"{240 * 'm'}.zip")
    run_folder(long, tmp_path).mkdir()


def test_the_latest_run_has_a_name_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr("behavexplor.campaign.config.RUNS", tmp_path)
    point_to_latest(tmp_path / "elsewhere" / "run")
    assert not list(tmp_path.iterdir())
    for name in ("first", "second"):
        point_to_latest(tmp_path / name)
        assert (tmp_path / "latest").readlink() == Path(name)
    (tmp_path / "second").mkdir()
    point_to_latest(tmp_path / "latest")  # a run that is resumed by that name
    assert (tmp_path / "latest").readlink() == Path("second")
    (tmp_path / "latest").unlink()
    (tmp_path / "latest").mkdir()
    point_to_latest(tmp_path / "third")
    assert (tmp_path / "latest").is_dir()
    assert not (tmp_path / "latest").is_symlink()
