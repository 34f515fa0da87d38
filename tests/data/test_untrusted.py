"""YAML from elsewhere: plain values are read, and values that would be too large are refused before they are made."""

import pytest

from behavexplor.data.untrusted import MAX_DEPTH, MAX_NODES, parse_yaml


def test_plain_values_are_read():
    text = "seed: 3\nenv: lane-follow\nshare: 0.5\nbudget: 1:30\nlimit: 0x10\nnames: [a, b]"
    values = {"seed": 3, "env": "lane-follow", "share": 0.5, "budget": 90, "limit": 16, "names": ["a", "b"]}
    assert parse_yaml(text) == values
    assert parse_yaml("") is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed: 0x" + "f" * 9000, "an integer in it is too long"),
        ("seed: " + "9" * 5000, "an integer in it is too long"),
        ("budget: 1" + ":59" * 3000, "an integer in it is too long"),
        ("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "nested too deeply"),
        ("&a [*a]", "nested too deeply"),
        (f"- &a [{', '.join('x' * 400)}]\n- [{', '.join(['*a'] * (MAX_NODES // 400))}]", "aliases make it too large"),
        ("a: !!python/object:os.system {}", "could not determine a constructor"),
    ],
)
def test_values_that_would_be_too_large_are_refused(text, message):
    with pytest.raises(ValueError, match=message):
        parse_yaml(text)
