"""Which folders are this machine's: the list of them, and how a folder of another machine becomes one."""

import importlib
import os
import re
import stat
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from behavexplor.campaign.config import CampaignConfig, stored_config
from behavexplor.campaign.opening import opened
from behavexplor.campaign.provenance import Consent, accepted, add_own, is_own, list_path, remember
from behavexplor.errors import InputError

ONE, OTHER = f"sha256:{'1' * 64}", f"sha256:{'2' * 64}"


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """Makes this another machine, whose list is empty."""

    def became(name):
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / name))

    became("first")
    return became


@pytest.fixture
def config(tmp_path, monkeypatch):
    """A configuration that names a user's own code."""
    (tmp_path / "own_spec_of_a_run.py").write_text("def lasts(trace):\n    return trace.duration\n")
    monkeypatch.syspath_prepend(tmp_path)
    options = {"initial_corpus": 3, "initial_energy": 2.0}
    return CampaignConfig("lane-follow", "constant", budget="3", specs=("own_spec_of_a_run:lasts",), options=options)


def run(config, folder, *, resume, until_its_end=True):
    with opened(config, folder, 0, resume=resume) as ready:
        if until_its_end:
            ready.campaign.run(lambda _: None)


def test_a_module_that_is_not_here_is_named_and_nothing_is_to_be_trusted(machine, config, tmp_path, monkeypatch):
    run(config, tmp_path / "run", resume=False)
    stored = stored_config(tmp_path / "run")
    del sys.modules["own_spec_of_a_run"]
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if Path(folder) != tmp_path])
    importlib.invalidate_caches()
    with pytest.raises(
        InputError, match="there is no module own_spec_of_a_run here: call this in the folder"
    ) as refused:
        accepted(stored)
    assert "--trust" not in str(refused.value)


def test_a_folder_that_was_trusted_is_this_machines_once_all_of_it_came_out_again(machine, config, tmp_path):
    folder = tmp_path / "run"
    run(config, folder, resume=False)
    stored = stored_config(folder)
    del sys.modules["own_spec_of_a_run"]
    assert accepted(stored).specs == config.specs
    assert "own_spec_of_a_run" in sys.modules  # from the very bytes that were looked at
    assert accepted(stored).target.modules.keys() == {"own_spec_of_a_run"}
    machine("second")
    with pytest.raises(InputError, match="this machine has not made this folder") as refused:
        accepted(stored)
    trusted = accepted(stored, Consent(trust=(re.search(r"--trust (\S+)", str(refused.value))[1],)))
    run(trusted, folder, resume=True, until_its_end=False)
    with pytest.raises(InputError, match="this machine has not made this folder"):
        accepted(stored)
    run(trusted, folder, resume=True)
    assert accepted(stored).specs == config.specs


def test_a_larger_budget_or_another_order_leaves_a_folder_this_machines_and_another_seed_does_not(
    machine, config, tmp_path
):
    run(config, tmp_path / "run", resume=False)
    stored = stored_config(tmp_path / "run")
    assert accepted(replace(stored, unverified=replace(config, budget="30")))
    assert accepted(replace(stored, unverified=replace(config, options=dict([*config.options.items()][::-1]))))
    with pytest.raises(InputError, match="this machine has not made this folder"):
        accepted(replace(stored, unverified=replace(config, seed=9)))


def test_the_list_has_each_folder_once_and_is_the_users_alone(machine):
    assert not is_own(ONE)
    remember([ONE, OTHER, ONE])
    add_own(OTHER)
    assert list_path().read_text().split() == [ONE, OTHER]
    assert stat.S_IMODE(list_path().stat().st_mode) == 0o600
    assert is_own(ONE)
    assert not is_own(ONE[:-1])


def test_what_a_crash_has_cut_off_spoils_no_other_line(machine):
    add_own(ONE)
    list_path().write_text(list_path().read_text() + OTHER[:20])
    add_own(OTHER)
    assert is_own(ONE)
    assert is_own(OTHER)


def test_what_a_user_does_not_say_counts_as_not_agreed():
    assert (Consent().trust, Consent().unconfined, Consent().names) == ((), False, ())


def test_code_that_was_replaced_since_the_run_was_made_is_not_imported(machine, config, tmp_path):
    run(config, tmp_path / "run", resume=False)
    del sys.modules["own_spec_of_a_run"]
    (tmp_path / "own_spec_of_a_run.py").write_text("raise SystemExit\n")
    with pytest.raises(InputError, match="this machine has not made this folder, or it has changed since"):
        accepted(stored_config(tmp_path / "run"))


def test_a_line_and_the_name_of_a_new_list_are_flushed_to_disk(machine, monkeypatch):
    flushed, fsync = [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda file: flushed.append(stat.S_ISDIR(os.fstat(file).st_mode)) or fsync(file))
    add_own(ONE)
    add_own(OTHER)
    assert flushed == [False, True, False]


@pytest.mark.parametrize("mode", [0o620, 0o602])
def test_a_list_that_others_may_write_does_not_count(machine, mode):
    add_own(ONE)
    list_path().chmod(mode)
    assert not is_own(ONE)


def test_a_list_that_is_a_link_neither_counts_nor_is_written(machine, canary):
    list_path().parent.mkdir(parents=True)
    canary.write_text("precious")
    list_path().symlink_to(canary)
    with pytest.warns(UserWarning, match="cannot be written"):
        remember([ONE])
    assert not is_own("precious")
