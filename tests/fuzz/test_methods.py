"""The contract of every registered search method, and the registry itself."""

import hashlib
import inspect
import json
import math
import re
import subprocess
import sys
from collections import deque
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from functools import cache, lru_cache
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
from pydantic import TypeAdapter

from behavexplor.campaign.config import REVISION, campaign_config, checked, read_config
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.envs.functional import IntersectionLeftEnv, IntersectionStraightEnv, LaneChangeEnv, LaneFollowEnv
from behavexplor.errors import InputError
from behavexplor.fuzz.encounters import EMPTY_ROAD
from behavexplor.fuzz.methods import METHODS, describe_method, load_method
from behavexplor.fuzz.search import Candidate, SearchExhausted
from behavexplor.judge.closest_approach import Nearness
from behavexplor.judge.specs import SPECS, Verdict, judge
from tests.fakes import make_trace, simulate

LOGICAL = IntersectionStraightEnv.logical
OTHER_PLACES = [IntersectionLeftEnv.logical, LaneFollowEnv.logical, LaneChangeEnv.logical]

EVERY = pytest.mark.parametrize("name", sorted(METHODS))
NEEDS = {"nsga2": "pymoo", "map-elites": "ribs", "novelty-search": "ribs"}
QUICK = {
    "samota": {"generations": 5, "local_generations": 5},
    "avfuzzer": {"restart_samples": 50},
}  # what costs time and shows nothing here
PRESETS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))


@lru_cache(maxsize=1000)
def driven(scenario, logical):
    """The trace of a scenario and its verdict; many campaigns ask for the same scenarios."""
    trace = simulate(scenario, logical)
    return trace, judge(trace)


def some_fail(verdict):
    return verdict


def all_fail(verdict):
    return Verdict(verdict.degrees, ("lines",))


def none_fails(verdict):
    return Verdict(verdict.degrees, ())


def build(name, seed=0, logical=LOGICAL):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    method = load_method(name)
    return method(logical, seed, method.Options(**QUICK.get(name, {})))


def campaign(search, executions, in_flight=1, verdict_of=some_fail, logical=LOGICAL):
    """What was asked for, told and learned: (candidate, trace, verdict, learned) in order."""
    waiting, records = deque(), []
    while len(records) < executions:
        while len(waiting) < min(in_flight, executions - len(records)):
            waiting.append(search.ask())
        candidate = waiting.popleft()
        trace, verdict = driven(candidate.scenario, logical)
        verdict = verdict_of(verdict)
        records.append((candidate, trace, verdict, search.tell(candidate, trace, verdict)))
    return records


def asked(records):
    return [(candidate.number, candidate.origin, candidate.parent, candidate.scenario) for candidate, *_ in records]


@cache
def played(name, in_flight):
    """A campaign of 80 executions, in which every option has an effect; several tests read it."""
    return campaign(build(name), 80, in_flight)


@EVERY
@pytest.mark.parametrize("in_flight", [1, 7, 64])
def test_candidates_are_valid_unique_and_numbered(name, in_flight):
    records = played(name, in_flight)
    assert [candidate.number for candidate, *_ in records] == list(range(80))
    assert len({candidate.scenario for candidate, *_ in records}) == 80
    for candidate, *_ in records:
        LOGICAL.check(candidate.scenario)
        assert candidate.origin
        assert candidate.parent is None or 0 <= candidate.parent < candidate.number


@EVERY
@pytest.mark.parametrize("in_flight", [1, 7])
def test_the_same_seed_gives_the_same_campaign(name, in_flight):
    first, second = played(name, in_flight)[:60], campaign(build(name), 60, in_flight)
    assert asked(first) == asked(second)
    assert [learned for *_, learned in first] == [learned for *_, learned in second]


@EVERY
def test_another_seed_gives_another_campaign(name):
    another = campaign(build(name, seed=1), 20)
    first, second = ({row[0].scenario for row in rows} for rows in (played(name, 1)[:20], another))
    assert first & second <= {ScriptedScenario(LOGICAL.name, ())}  # the empty road is the same for all


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
    search, records, texts = build(name), [], []
    for _ in range(80):
        candidate = search.ask()
        records.append((candidate,))
        texts.append(candidate.scenario.to_json())
        search.tell(candidate, *driven(candidate.scenario, LOGICAL))
    assert [candidate.scenario.to_json() for (candidate,) in records] == texts
    for (candidate,) in records:
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
        assert len(candidate.scenario.npcs) == (0 if candidate.origin == EMPTY_ROAD else n_npcs)


@EVERY
def test_the_shortest_traces_without_npcs_or_lines(name):
    search, trace = build(name), make_trace(np.zeros((1, 3)))
    for _ in range(40):
        candidate = search.ask()
        assert json.dumps(dict(search.tell(candidate, trace, judge(trace, SPECS))), allow_nan=False)


@EVERY
def test_runs_that_are_all_the_same(name):
    search, (trace, verdict) = build(name), driven(LOGICAL.sample(np.random.default_rng(3)), LOGICAL)
    candidates = []
    for _ in range(60):
        candidates.append(search.ask())
        search.tell(candidates[-1], trace, none_fails(verdict))
    assert len({candidate.scenario for candidate in candidates}) == 60


@EVERY
def test_candidates_in_flight_when_a_campaign_ends_are_no_trouble(name):
    """And asks and tells may come in bursts."""
    search, waiting = build(name), deque()
    for burst in (1, 30, 3, 12):
        waiting.extend(search.ask() for _ in range(burst))
        for _ in range(len(waiting) // 2):
            candidate = waiting.popleft()
            search.tell(candidate, *driven(candidate.scenario, LOGICAL))
    assert len(waiting) > 5


@EVERY
@pytest.mark.parametrize("logical", OTHER_PLACES, ids=lambda logical: logical.name)
def test_other_places(name, logical):
    for candidate, *_ in campaign(build(name, logical=logical), 30, logical=logical):
        logical.check(candidate.scenario)


class Watched:
    """Options that note which of them are read."""

    def __init__(self, options, read, prefix=""):
        self._options, self._read, self._prefix = options, read, prefix

    def __getattr__(self, name):
        value = getattr(self._options, name)
        self._read.add(f"{self._prefix}{name}")
        return Watched(value, self._read, f"{self._prefix}{name}.") if is_dataclass(value) else value


def keys(options, prefix=""):
    """Names of all options, also within options."""
    for field in fields(options):
        yield f"{prefix}{field.name}"
        if is_dataclass(value := getattr(options, field.name)):
            yield from keys(value, f"{prefix}{field.name}.")


@cache
def preset(path):
    """The configuration in a file, and a campaign with its options: what it told, and which options it read."""
    config = campaign_config(read_config(str(path)))
    kind = load_method(config.method)
    options, read = checked(kind.Options, config.options, "options"), set()
    return config, options, campaign(kind(LOGICAL, 0, Watched(options, read)), 80), read


@EVERY
def test_every_option_is_read(name):
    """By a campaign with the defaults, or by one with a preset."""
    kind, read = load_method(name), set()
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    with suppress(SearchExhausted):
        campaign(kind(LOGICAL, 0, Watched(kind.Options(), read)), 80)
    for path in PRESETS:
        if not set(keys(kind.Options())) <= read and campaign_config(read_config(str(path))).method == name:
            read |= preset(path)[-1]
    assert set(keys(kind.Options())) <= read


@pytest.mark.parametrize("path", PRESETS, ids=lambda path: path.stem)
def test_presets_are_campaigns_of_their_own(path):
    """Each runs, says something else than the others, and names nothing that is the default anyway."""
    _, options, records, _ = preset(path)
    assert len(records) == 80
    if path.stem not in ("paper", "window-10"):
        assert options != type(options)()


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
    source = inspect.getsource(options)
    for field in fields(options):  # each is described beside it, or by the docstring of its own class
        beside = rf"^    # .*\n    {field.name}: |^    {field.name}: .*  # "
        assert re.search(beside, source, re.MULTILINE) or is_dataclass(getattr(options(), field.name, None)), field.name


def said_of_options(name, column=0):
    """The defaults that docs/methods.md says in the section of a method: after its sentence on options, or in a table.

    The table has the defaults in one column, and those of the preset `released` in another one.
    """
    page = (Path(__file__).parents[2] / "docs" / "methods.md").read_text()
    section = page.partition(f" (`{name}`)\n")[2].partition("\n## ")[0]
    paragraphs = [" ".join(paragraph.split()) for paragraph in section.split("\n\n")]
    sentence = "".join(paragraph.partition("Options, with their defaults")[2] for paragraph in paragraphs)
    table = section.partition("| option | `paper` (default) | `released` |")[2].partition("\n\n")[0]
    rows = re.findall(r"^\| `([\w.]+)`" + r" \| `?([\w.-]+)[^|]*" * 2, table, re.MULTILINE)
    listed = re.findall(r"`([\w.]+)` \(([^()]+)\)", sentence)
    return {key: as_number(said) for key, said in listed + [(key, values[column]) for key, *values in rows]}


def as_number(words):
    try:
        return float(words)
    except ValueError:
        return words


def as_said(value):
    if isinstance(value, tuple):
        return ", ".join(value)
    return {"None": "none", "True": "true"}.get(str(value), value)


def values_of(options):
    values = {key: attrgetter(key)(options) for key in keys(options)}
    return {key: as_said(one) for key, one in values.items() if not is_dataclass(one)}


@EVERY
def test_the_page_says_every_option_with_its_default(name):
    """It is the page on which a number of a publication stands beside its source."""
    assert said_of_options(name) == values_of(load_method(name).Options())


def test_the_page_says_what_the_preset_of_the_released_program_changes():
    options = read_config("released")["options"]
    released = checked(load_method("behavexplor").Options, options, "options")
    assert said_of_options("behavexplor", column=1) == values_of(released)


@EVERY
def test_a_method_says_whether_it_uses_the_nearness_of_failures(name, monkeypatch):
    """Judges compute it for those that say so; see `SearchMethod`."""
    computed, original = [], Nearness.of
    monkeypatch.setattr(Nearness, "of", lambda *given: computed.append(given) or original(*given))
    campaign(build(name), 1)
    assert getattr(load_method(name), "uses_nearness", False) is bool(computed)


@pytest.mark.parametrize("name", [name for name in METHODS if hasattr(load_method(name), "foreseen")])
def test_no_result_changes_the_candidates_that_a_method_foresees(name):
    """They may be asked for early, and are the same then."""
    search = build(name)
    first = search.ask()
    early = [first, *(search.ask() for _ in range(min(search.foreseen, 60)))]
    assert len(early) > 10
    assert asked([(one,) for one in early]) == asked(played(name, 1))[: len(early)]


CANDIDATES = {  # digests of the first 80, in all versions of a revision
    "behavexplor": "1c006bba119ac8c0",
    "random": "ff459a7179630d5d",
    "avfuzzer": "5d7489032017e8d9",
    "niching": "50cc8b3e0885e90b",
    "uniform": "625cda73b336aff1",
}


@pytest.mark.skipif(REVISION != 3, reason="the digests are those of revision 3")
@pytest.mark.parametrize("name", CANDIDATES)
def test_a_method_asks_for_the_same_in_all_versions_of_a_revision(name):
    """If it shall ask for something else, raise `REVISION`.

    Methods that use libraries depend on their versions, too. The speeds of aimed vehicles are not rounded: their last
    bits depend on the processor.
    """
    digest = hashlib.sha256()
    for number, origin, parent, scenario in asked(played(name, 1)):
        digest.update(f"{number} {origin} {parent} {scenario.to_json()}".encode())
    assert digest.hexdigest()[:16] == CANDIDATES[name]


@EVERY
def test_it_is_described_in_a_line(name):
    line = describe_method(name)
    assert 10 < len(line) < 120
    assert line.endswith(".")


def test_unknown_names():
    with pytest.raises(InputError, match="Unknown search method 'behavexplorer': did you mean 'behavexplor'"):
        load_method("behavexplorer")


@EVERY
def test_a_slip_of_the_pen_is_recognized(name):
    with pytest.raises(InputError, match=f"did you mean '{name}'"):
        load_method(name[:-1])


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
        "heavy = ('sklearn', 'torch', 'highway_env', 'pandas', 'pymoo', 'ribs');"
        "print([name for name in heavy if name in sys.modules])"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert output.strip() == "[]"
