"""What users read when their input is wrong: one line that a terminal can show."""

import pickle

import pytest

from behavexplor.errors import LONGEST, InputError, sentence, unknown_name


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("The seed -1 is wrong: take 0", "The seed -1 is wrong: take 0"),
        ("several\nlines\r\n  of\u2028text\t", "several lines of text"),
        ("clears \x1b[2J the screen", "clears \\x1b[2J the screen"),
        ("turns \u202e the line", "turns \\u202e the line"),
        ("no text: \udcff\0", "no text: \\udcff\\x00"),
        ("schön, 42 °", "schön, 42 °"),
    ],
)
def test_a_message_is_one_printable_line(message, shown):
    assert str(InputError(message)) == shown


@pytest.mark.parametrize("message", ["x" * 10**6, "\x1b" * 10**6, "a b " * 10**6, " " * 10**6 + "x"])
def test_a_message_is_never_long(message):
    shown = str(InputError(message))
    assert 0 < len(shown) <= LONGEST
    assert sentence(shown) == shown


def test_a_message_survives_other_processes():
    error = InputError("x" * 2000)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("rulle", "did you mean 'rule'?"),
        ("lane", "did you mean 'lane-change' or 'lane-follow'?"),
        ("x", "known are lane-change, lane-follow, rule."),
        ("", "known are lane-change, lane-follow, rule."),
    ],
)
def test_an_unknown_name_is_told_the_nearest(name, hint):
    assert str(unknown_name("thing", name, ["rule", "lane-follow", "lane-change"])).endswith(hint)
