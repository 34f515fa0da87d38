"""Figures of a report, without a run."""

import pytest

from behavexplor.report.run_page import _by_requirement, _value_text


def test_failures_beside_the_three_requirements_are_named():
    assert _by_requirement({"collision": 3, "lines": 2, "destination": 1}) == "3, 2, 1"
    counts = {"collision": 3, "lines": 2, "destination": 1, "error": 5}
    assert _by_requirement(counts) == "3, 2, 1, error 5"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "none"),
        ((), "none"),
        ({}, "none"),
        ("", "none"),
        (True, "yes"),
        (0, "0"),
        ("750", "750"),
        (("a:b", "c:d"), "a:b, c:d"),
        ({"bounded": False, "miner": {"window": 5}}, "bounded: no, miner: window: 5"),
    ],
)
def test_parameters_are_written_as_readers_would(value, text):
    assert _value_text(value) == text
