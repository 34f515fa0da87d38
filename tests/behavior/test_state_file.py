"""The states of many behaviors, in memory and in a file."""

import gc
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest

from behavexplor.behavior.features import ATTRIBUTES
from behavexplor.behavior.miner import StateFile

BEHAVIORS = [
    np.random.default_rng(n).random((length, len(ATTRIBUTES)), np.float32) for n, length in enumerate([3, 0, 9])
]


@pytest.mark.parametrize("in_memory", [1, 100, 10_000])
def test_states_come_back_in_order_and_again(in_memory):
    file = StateFile(in_memory)
    for count, states in enumerate(BEHAVIORS, 1):
        file.append(states)
        assert len(file) == count
        for _ in range(2):
            assert [found.tolist() for found in file] == [states.tolist() for states in BEHAVIORS[:count]]


@pytest.mark.parametrize("in_memory", [1, 10_000])
def test_states_are_added_at_the_end_wherever_they_are_read(in_memory):
    file = StateFile(in_memory)
    for states in BEHAVIORS:
        file.append(states)
    next(reading := iter(file))
    file.append(BEHAVIORS[0])
    reading.close()
    assert [found.tolist() for found in file] == [states.tolist() for states in (*BEHAVIORS, BEHAVIORS[0])]


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="counts open files in /proc")
def test_sixteen_mebibytes_are_kept_in_memory():
    gc.collect()
    before, file = open_files(), StateFile()
    file.append(np.zeros((2**24 // 32, len(ATTRIBUTES)), np.float32))
    assert open_files() == before
    file.append(BEHAVIORS[0][:1])
    assert open_files() == before + 1


def open_files():
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="counts open files in /proc")
def test_a_file_is_opened_for_many_states_only_and_goes_with_its_object(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    gc.collect()
    before = open_files()
    file = StateFile(in_memory=200)
    file.append(BEHAVIORS[0])
    assert open_files() == before
    file.append(BEHAVIORS[2])
    assert open_files() == before + 1
    assert list(tmp_path.iterdir()) == []
    del file
    gc.collect()
    assert open_files() == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a file that is always full")
def test_a_full_disk_is_an_error_once(monkeypatch):
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: open("/dev/full", "w+b"))  # noqa: PTH123, SIM115
    file = StateFile(in_memory=1)
    with pytest.raises(OSError, match=f"No space left on device: '{re.escape(tempfile.gettempdir())}'"):
        file.append(np.zeros((9999, len(ATTRIBUTES)), np.float32))
    del file
    gc.collect()  # closing it raises nothing
