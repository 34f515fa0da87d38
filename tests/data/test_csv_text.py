"""Tables as CSV."""

import csv
import io

import pytest

from behavexplor.data.csv_text import csv_text


@pytest.mark.parametrize("text", ["=1+1", "+1+cmd|' /C calc'!A0", "-2+3", "@SUM(A1)", "\t=1"])
def test_a_text_that_a_spreadsheet_would_compute_begins_with_an_apostrophe(text):
    ((cell, number, name),) = csv.reader(io.StringIO(csv_text([[text, -1.5, "a=b"]]), newline=""))
    assert (cell, number, name) == (f"'{text}", "-1.5", "a=b")


def test_control_characters_in_a_text_make_no_rows():
    assert csv_text([["a\r=1\x1b[2J", 1]]) == "a\\r=1\\x1b[2J,1\n"
