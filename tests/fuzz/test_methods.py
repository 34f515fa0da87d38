"""The contract of every registered search method, and the registry itself."""

import json
import math
import subprocess
import sys
from collections import deque
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace

import pytest
from pydantic import TypeAdapter

from behavexplor.envs.functional.intersection_straight import IntersectionStraightEnv
from behavexplor.errors import InputError
from behavexplor.fuzz.methods import METHODS, describe_method, load_method
from behavexplor.fuzz.search import Candidate, SearchExhausted
from behavexplor.fuzz.specs import Verdict, judge

from .fakes import simulate

LOGICAL = IntersectionStraightEnv.logical

EVERY = pytest.mark.parametrize("name", sorted(METHODS))


def some_fail(trace):
    return judge(trace)


def all_fail(trace):
    return Verdict(judge(trace).degrees, ("lines",))


def none_fails(trace):
    return Verdict(judge(trace).degrees, ())


def build(name, seed=0, logical=LOGICAL):
    method = load_method(name)
    return method(logical, seed, method.Options())


def campaign(search, executions, in_flight=1, verdict_of=some_fail, logical=LOGICAL):
    """What was asked for, told and learned: (candidate, trace, verdict, learned) in order."""
    waiting, records = deque(), []
    while len(records) < executions:
        while len(waiting) < min(in_flight, executions - len(records)):
            waiting.append(search.ask())
        candidate = waiting.popleft()
        trace = simulate(candidate.scenario, logical)
        verdict = verdict_of(trace)
        records.append((candidate, trace, verdict, search.tell(candidate, trace, verdict)))
    return records


def asked(records):
    return [(candidate.number, candidate.origin, candidate.parent, candidate.scenario) for candidate, *_ in records]


@EVERY
@pytest.mark.parametrize("in_flight", [1, 7, 64])
def test_candidates_are_valid_unique_and_numbered(name, in_flight):
    records = campaign(build(name), 120, in_flight)
    assert [candidate.number for candidate, *_ in records] == list(range(120))
    assert len({candidate.scenario for candidate, *_ in records}) == 120
    for candidate, *_ in records:
        LOGICAL.check(candidate.scenario)
        assert candidate.origin
        assert candidate.parent is None or 0 <= candidate.parent < candidate.number


@EVERY
@pytest.mark.parametrize("in_flight", [1, 16])
def test_the_same_seed_gives_the_same_campaign(name, in_flight):
    first, second = (campaign(build(name, seed=5), 60, in_flight) for _ in range(2))
    assert asked(first) == asked(second)
    assert [learned for *_, learned in first] == [learned for *_, learned in second]


@EVERY
def test_another_seed_gives_another_campaign(name):
    first, second = (campaign(build(name, seed=seed), 20) for seed in (0, 1))
    assert not {candidate.scenario for candidate, *_ in first} & {candidate.scenario for candidate, *_ in second}


@EVERY
def test_a_fresh_instance_told_the_same_goes_on_as_the_first(name):
    search = build(name)
    records = campaign(search, 50, in_flight=4)
    again = build(name)
    waiting = deque()
    for i, (candidate, trace, verdict, learned) in enumerate(records):
        while len(waiting) < min(4, 50 - i):
            waiting.append(again.ask())
        assert waiting.popleft() == candidate
        assert again.tell(candidate, trace, verdict) == learned
    assert asked(campaign(again, 20)) == asked(campaign(search, 20))


@EVERY
def test_parents_are_not_mutated(name):
    records = campaign(build(name), 80)
    texts = [candidate.scenario.to_json() for candidate, *_ in records]
    again = asked(campaign(build(name), 80))
    assert [scenario.to_json() for *_, scenario in again] == texts
    for candidate, *_ in records:
        if candidate.parent is not None:
            assert candidate.scenario != records[candidate.parent][0].scenario


@EVERY
def test_an_ads_that_always_fails(name):
    """It goes on, or says that there is nothing to search; nothing else."""
    records = []
    with suppress(SearchExhausted):
        records = campaign(build(name), 40, verdict_of=all_fail)
    for candidate, *_ in records:
        LOGICAL.check(candidate.scenario)


@EVERY
def test_an_ads_that_never_fails(name):
    assert len(campaign(build(name), 80, verdict_of=none_fails)) == 80


@EVERY
@pytest.mark.parametrize("n_npcs", [1, 12])
def test_other_numbers_of_npcs(name, n_npcs):
    logical = replace(LOGICAL, n_npcs=n_npcs)
    for candidate, *_ in campaign(build(name, logical=logical), 30, logical=logical):
        logical.check(candidate.scenario)
        assert len(candidate.scenario.npcs) == n_npcs


@EVERY
def test_what_is_learned_and_shown_can_be_stored(name):
    search = build(name)
    assert all(math.isfinite(value) for value in search.status().values())
    names = set()
    for *_, learned in campaign(search, 40):
        assert json.loads(json.dumps(dict(learned), allow_nan=False)) == dict(learned)
        assert all(isinstance(value, int | float) for value in search.status().values())
        names.add(frozenset(search.status()))
    assert len(names) == 1


@EVERY
def test_options_are_a_frozen_dataclass_that_configs_can_fill(name):
    options = load_method(name).Options
    assert is_dataclass(options)
    assert options.__dataclass_params__.frozen
    adapter = TypeAdapter(options)
    defaults = adapter.dump_python(options())
    assert adapter.validate_python(defaults) == options()
    for field in fields(options):
        assert f"{field.name}:" in options.__doc__


@EVERY
def test_it_is_described_in_a_line(name):
    line = describe_method(name)
    assert 10 < len(line) < 120
    assert line.endswith(".")


def test_unknown_names():
    with pytest.raises(InputError, match="Unknown search method 'behavexplorer': did you mean 'behavexplor'"):
        load_method("behavexplorer")


@pytest.mark.parametrize("name", ["no_such_package:Search", "behavexplor.fuzz.uniform:Nothing", ":", "math:"])
def test_what_cannot_be_imported(name):
    with pytest.raises(InputError, match="cannot be imported"):
        load_method(name)


@pytest.mark.parametrize(
    ("name", "lack"), [("math:pi", "it lacks Options, ask"), ("builtins:dict", "it lacks Options")]
)
def test_what_is_no_search_method(name, lack):
    with pytest.raises(InputError, match=f"{name!r} is not a search method: {lack}"):
        load_method(name)


def test_any_class_by_its_path():
    assert load_method("behavexplor.fuzz.uniform:Uniform") is load_method("uniform")


def test_candidates_are_frozen():
    candidate = Candidate(0, LOGICAL, "initial", None)
    with pytest.raises(AttributeError):
        candidate.number = 1


def test_importing_every_method_stays_light():
    """They are described in --help, and a campaign of one does not pay for the libraries of another."""
    code = (
        "import sys; from behavexplor.fuzz.methods import *;"
        "[describe_method(name) for name in METHODS];"
        "print([name for name in ('sklearn', 'scipy', 'torch', 'highway_env', 'pandas') if name in sys.modules])"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert output.strip() == "[]"
