"""What happened in a scenario, and the file of an evaluation: written, read back, gone on with and refused."""

import json

import numpy as np
import pytest

from behavexplor.errors import InputError
from behavexplor.judge.outcomes import (
    OutcomeBlock,
    OutcomeFile,
    Outcomes,
    outcomes_from,
    outcomes_of,
    outcomes_of_error,
    packed,
    unpacked,
)
from tests.judge.traces import driven

SUBJECT = {"seed": 1, "driver": "idm"}
ARRIVED = Outcomes(("arrived",), ("arrived", "collision"), at_fault=False)
STRUCK = Outcomes(("collision", "collision: npc_rear_end"), ("arrived", "collision"), at_fault=False)
BLOCKS = [OutcomeBlock([ARRIVED, STRUCK, ARRIVED], {"state": 5}), OutcomeBlock([STRUCK], None), OutcomeBlock([], [1])]
ALL = ("arrived", "collision", "lines", "destination")
LINE = np.array([[[-9.0, 0.5], [9.0, 0.5]]])


def signals(**found):
    return {"way": np.zeros(3), **{name: np.array([0.0, 0.0, float(value)]) for name, value in found.items()}}


def stands(npc=(60.0, 0.0, 0.0, 0.0), **fields):
    """An ego that stands at the origin, and an NPC as given in the end."""
    return driven(np.zeros((3, 4)), np.tile(npc, (3, 1)), **fields)


@pytest.mark.parametrize(
    ("trace", "found", "asked", "at_fault"),
    [
        (stands(end="arrived", destination=[0.0, 0.0]), ["arrived"], ALL, False),
        (stands(destination=[0.0, 0.0]), [], ALL, False),
        (stands(), ["destination"], ALL, True),
        (stands(illegal_lines=LINE), ["lines", "destination"], ALL, True),
        (
            stands((3.0, 0.0, 3.0, 5.0), end="collision"),
            ["collision", "destination", "collision: struck_stationary"],
            ALL,
            False,
        ),
        (stands(signals=signals(crashed=0)), [], ("collision",), False),
        (stands(signals=signals(crashed=0, arrived=1)), ["arrived"], ("arrived", "collision", "destination"), False),
        (stands(signals=signals(crashed=0, arrived=0)), ["destination"], ("arrived", "collision", "destination"), True),
        (stands(signals=signals(crashed=0, off_road=1)), ["lines"], ("collision", "lines"), True),
        (
            stands(signals=signals(crashed=1, arrived=1, changing_lanes=0), end="collision"),
            ["collision"],
            ("arrived", "collision", "destination"),
            True,
        ),
    ],
)
def test_outcomes_are_what_a_trace_and_its_signals_say(trace, found, asked, at_fault):
    assert outcomes_of(trace) == Outcomes(tuple(found), asked, at_fault)


def test_a_driver_passes_if_nothing_happened_but_an_arrival():
    assert ARRIVED.passed
    assert Outcomes((), ("collision",), at_fault=False).passed
    assert not STRUCK.passed
    assert not Outcomes(("arrived", "lines"), ALL, at_fault=True).passed
    assert outcomes_of_error("raised") == Outcomes(("error", "error: raised"), (), at_fault=True)


def test_values_are_kinds_and_a_letter_for_each_scenario():
    values = packed([STRUCK, ARRIVED, STRUCK])
    assert values == {"kinds": [STRUCK, ARRIVED], "codes": "ABA"}
    assert unpacked(json.loads(json.dumps(values))) == [STRUCK, ARRIVED, STRUCK]
    assert outcomes_from(["lines"], ["lines"], True) == Outcomes(("lines",), ("lines",), at_fault=True)


def filled(path):
    file = OutcomeFile(path, SUBJECT)
    for block in BLOCKS:
        file.append(block)
    return file


def test_blocks_are_written_and_read_back(tmp_path):
    path = tmp_path / "outcomes.jsonl"
    assert list(OutcomeFile(path, SUBJECT).blocks()) == []
    assert path.read_text() == '{"driver": "idm", "seed": 1}\n'
    assert list(filled(path).blocks()) == BLOCKS
    again = OutcomeFile(path, dict(reversed(SUBJECT.items())))
    assert list(again.blocks()) == BLOCKS
    again.append(BLOCKS[0])
    assert list(OutcomeFile(path, SUBJECT).blocks()) == [*BLOCKS, BLOCKS[0]]


def test_a_file_that_was_cut_short_begins_with_its_whole_blocks(tmp_path):
    content = filled(tmp_path / "whole").path.read_bytes()
    ends = [i + 1 for i, byte in enumerate(content) if byte == ord("\n")]
    for size in range(len(content) + 1):
        path = tmp_path / str(size)
        path.write_bytes(content[:size])
        whole = sum(end <= size for end in ends)
        assert list(OutcomeFile(path, SUBJECT).blocks()) == BLOCKS[: max(whole - 1, 0)]
        assert path.read_bytes() == content[: ends[max(whole, 1) - 1]]


@pytest.mark.parametrize(
    "line", ["{", "[]", "{}", '{"kinds": []}', '{"kinds": [], "codes": "A", "state": 1}', '{"kinds": 1, "codes": ""}']
)
def test_a_damaged_block_is_named_by_its_line(line, tmp_path):
    file = filled(tmp_path / "file")
    with file.path.open("a") as stream:
        stream.write(f"{line}\n")
    with pytest.raises(InputError, match="file, line 5, is damaged: delete it and those behind it"):
        list(file.blocks())


def test_a_file_of_another_evaluation_or_that_is_gone_is_refused(tmp_path):
    file = filled(tmp_path / "file")
    content = file.path.read_bytes()
    with pytest.raises(InputError, match="belongs to another evaluation"):
        OutcomeFile(file.path, {**SUBJECT, "seed": 2})
    assert file.path.read_bytes() == content
    with pytest.raises(InputError, match="cannot be used: No such file"):
        OutcomeFile(tmp_path / "no-folder" / "file", SUBJECT)
    with pytest.raises(InputError, match="cannot be used"):
        OutcomeFile(tmp_path, SUBJECT)
    (tmp_path / "link").symlink_to(file.path)  # it could lead to any file of the user
    with pytest.raises(InputError, match="link cannot be used"):
        OutcomeFile(tmp_path / "link", SUBJECT)
    assert file.path.read_bytes() == content
    file.path.unlink()
    with pytest.raises(InputError, match="was deleted or moved while the evaluation ran"):
        file.append(BLOCKS[0])
    assert not file.path.exists()
