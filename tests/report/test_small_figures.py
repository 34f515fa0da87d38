"""Figures of a report, without a run."""

from behavexplor.report.run_page import _by_requirement


def test_failures_beside_the_three_requirements_are_named():
    assert _by_requirement({"collision": 3, "lines": 2, "destination": 1}) == "3, 2, 1"
    counts = {"collision": 3, "lines": 2, "destination": 1, "error": 5}
    assert _by_requirement(counts) == "3, 2, 1, error 5"
