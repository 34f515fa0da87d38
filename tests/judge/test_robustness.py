"""Specs of a user: their names, their degrees, and how they are loaded from a module."""

import numpy as np
import pytest

from behavexplor.errors import InputError
from behavexplor.judge.robustness import RESERVED, RobustnessSpec, as_spec, load_spec, load_specs
from behavexplor.judge.specs import NOTHING_NEAR, SPECS, judge
from tests.judge.traces import driven

TRACE = driven(np.zeros((2, 4)))
MODULE = """
def gentle(trace):
    return 1.0

class Brisk:
    name = "brisk-drive"

    def __call__(self, trace):
        return len(trace.time) - 3.0

class Nameless:
    def __call__(self, trace):
        return 2.0

class Costly:
    def __init__(self, price):
        pass

number = 3
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """The name of a module of a user, which no other test has imported."""
    name = f"specs_of_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    return name


@pytest.mark.parametrize(
    ("robustness", "degree", "violated"),
    [
        (2.5, 2.5, False),
        (0.0, 0.0, False),
        (-1e-9, 0.0, True),
        (float("inf"), NOTHING_NEAR, False),
        (NOTHING_NEAR - 1, NOTHING_NEAR - 1, False),
        (np.float32(-7), 0.0, True),
        (np.array(3), 3.0, False),
    ],
)
def test_the_degree_is_the_robustness_above_zero(robustness, degree, violated):
    verdict = judge(TRACE, [RobustnessSpec("own", lambda _: robustness)])
    assert (verdict.degrees["own"], verdict.failed) == (degree, violated)


@pytest.mark.parametrize("value", [True, np.True_, "1.0", b"1", None, float("nan"), [1.0, 2.0], {}, 10**400])
def test_what_is_no_number_is_refused(value):
    spec = RobustnessSpec("own", lambda _: value)
    with pytest.raises(InputError, match=r"^The spec 'own' returned .*: it must return a number, negative if"):
        spec(TRACE)
    with pytest.raises(InputError, match=r"^The spec 'own' \(mine:own\) returned"):
        RobustnessSpec("own", spec.robustness, "mine:own").degree(TRACE)


@pytest.mark.parametrize("name", [*sorted(RESERVED), "", "1st", "-x", "a b", "x" * 65, "a/b", "a\n"])
def test_a_name_that_is_taken_or_no_word_is_refused(name):
    with pytest.raises(InputError, match="cannot be named"):
        RobustnessSpec(name, abs)


def test_reserved_names_are_those_of_records():
    assert {"error", "arrived", "other", "R1", "R2", "R3", "collision", "lines", "destination"} == RESERVED
    for name in ("a", "_", "x" * 64, "my-spec_2.b"):
        assert RobustnessSpec(name, abs).name == name


def test_specs_that_differ_in_their_source_only_are_equal():
    assert RobustnessSpec("own", abs, "a:own") == RobustnessSpec("own", abs, "b:own") != RobustnessSpec("own", max)


def test_specs_of_a_module_join_those_of_the_paper(module):
    found = load_specs([f"{module}:gentle", f"{module}:Brisk", f"{module}:Nameless"])
    assert found[:3] == SPECS
    assert [spec.name for spec in found[3:]] == ["gentle", "brisk-drive", "Nameless"]
    assert [spec.source for spec in found[3:]] == [f"{module}:{name}" for name in ("gentle", "Brisk", "Nameless")]
    assert [spec(TRACE) for spec in found[3:]] == [1.0, -1.0, 2.0]
    assert load_specs([]) == SPECS


@pytest.mark.parametrize("names", [["gentle", "gentle"], ["Brisk", "gentle", "Brisk"]])
def test_two_specs_of_one_name_are_refused(names, module):
    with pytest.raises(InputError, match=r"Two specs are named '(gentle|brisk-drive)': give each a name of its own"):
        load_specs([f"{module}:{name}" for name in names])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("{}:nothing", "cannot be imported: AttributeError: .*'nothing'$"),
        ("{}_gone:gentle", r"cannot be imported: ModuleNotFoundError: .*this folder and on PYTHONPATH\)$"),
        ("{}:Costly", "cannot be constructed: TypeError"),
        ("{}:number", "is not callable: give a function that takes a Trace"),
        ("{}", "must be written as package.module:attribute"),
        ("{}:", "must be written as package.module:attribute"),
        (":gentle", "must be written as package.module:attribute"),
    ],
)
def test_what_cannot_be_loaded_is_told_why(name, message, module):
    with pytest.raises(InputError, match=message):
        load_spec(name.format(module))


def test_what_is_given_in_python_is_named_by_itself():
    with pytest.raises(InputError, match="The spec 3 is not callable"):
        as_spec(3)
    assert as_spec(abs).name == "abs"
    with pytest.raises(InputError, match="The spec <lambda> cannot be named '<lambda>'"):
        as_spec(lambda _: 1.0)
