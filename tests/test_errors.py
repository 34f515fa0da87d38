"""What users read when their input is wrong: one line that a terminal can show."""

import pickle

import pytest

from behavexplor.errors import LONGEST, InputError, brief, described, ignored_key, printable, sentence, unknown_name


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


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("one\n\ttwo, schön \U0001f697\n", "one\n\ttwo, schön \U0001f697\n"),
        ("\x1b]52;c;bHM=\x07\x1b[2J", "\\x1b]52;c;bHM=\\x07\\x1b[2J"),
        ("100 %\r0 %\x08\x0b\x0c", "100 %\\r0 %\\x08\\x0b\\x0c"),
        ("one\u2028two\u2029three\x85", "one\\u2028two\\u2029three\\x85"),
    ],
)
def test_a_terminal_is_shown_escapes_in_place_of_what_could_change_it(text, shown):
    assert printable(text) == shown


def test_no_control_character_mark_of_direction_or_surrogate_reaches_a_terminal():
    codes = [*range(0x20), *range(0x7F, 0xA0), 0x61C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A)]
    for char in map(chr, [*codes, 0xD800, 0xDFFF, 0xFEFF, 0xE0001]):
        assert (printable(char) == char) == (char in "\n\t")
        assert printable(char).replace("\n", "").replace("\t", "").isascii()


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


class Nameless(type):
    @property
    def __name__(cls):
        raise ValueError


def test_a_class_has_a_name_whatever_its_metaclass_does():
    kind = Nameless("Odd", (Exception,), {"__repr__": lambda _: 1 / 0})
    assert described(kind("x")) == "Odd: x"
    assert brief(kind()) == "a Odd that cannot be shown"


@pytest.mark.parametrize(
    ("key", "hint"), [("lane_count", ": did you mean 'lanes_count'?"), ("duration", ""), ("vehicles_count", "")]
)
def test_only_a_misspelled_key_is_taken_for_another_one(key, hint):
    known = ("action", "lanes_count", "observation", "other_vehicles_type")
    assert ignored_key("merge-v0", key, known).endswith(f"which highway-env ignores{hint}")
