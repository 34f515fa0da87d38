"""MAP-Elites and novelty search: what their archives hold, and what variation makes of it."""

import sys
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from behavexplor.errors import InputError
from behavexplor.fuzz.quality_diversity import (
    MAPElites,
    MAPElitesOptions,
    NoveltySearch,
    NoveltySearchOptions,
    VariationOptions,
)
from behavexplor.judge.specs import Verdict
from tests.fakes import LOGICAL, make_trace

pytestmark = pytest.mark.skipif(find_spec("ribs") is None, reason="needs the extra search")


def drive(speed, seconds=10.0):
    x = np.arange(int(seconds * 20)) / 20 * speed
    return make_trace(np.stack([x, 0 * x, 0 * x], axis=1))


def verdict(degree, *, failed=False):
    return Verdict({"collision": degree}, ("collision",) if failed else ())


def tell_next(search, trace, outcome):
    candidate = search.ask()
    return candidate, search.tell(candidate, trace, outcome)


def elites(**options):
    return MAPElites(LOGICAL, 0, MAPElitesOptions(**{"initial": 1, **options}))


def test_a_cell_keeps_the_scenario_of_least_degree():
    search = elites()
    _, first = tell_next(search, drive(5.0), verdict(3.0))
    _, worse = tell_next(search, drive(5.0), verdict(4.0))
    _, better = tell_next(search, drive(5.0), verdict(2.0))
    _, elsewhere = tell_next(search, drive(9.0), verdict(9.0))
    assert [learned["kept"] for learned in (first, worse, better, elsewhere)] == [True, False, True, True]
    assert first["cell"] == worse["cell"] != elsewhere["cell"]
    assert search.status() == {"elites": 2, "coverage": pytest.approx(2 / 144)}


def test_a_failure_is_better_than_anything_else_and_only_the_first_stays():
    search = elites()
    tell_next(search, drive(5.0), verdict(0.5))
    failed, learned = tell_next(search, drive(5.0), verdict(9.0, failed=True))
    assert learned["kept"]
    assert not tell_next(search, drive(5.0), verdict(0.0, failed=True))[1]["kept"]
    assert search.ask().parent == failed.number


def test_measures_and_bins_span_the_archive():
    search = elites(measures=("duration", "standing", "mean-speed"), bins=4)
    cells = {
        tell_next(search, drive(speed, seconds), verdict(1.0))[1]["cell"]
        for speed, seconds in ((0.0, 10), (9.0, 10), (0.0, 100), (9.0, 100), (9.0, 101))
    }
    assert len(cells) == 4
    assert search.status()["coverage"] == pytest.approx(4 / 64)


@pytest.mark.parametrize("make", [elites, lambda **options: NoveltySearch(LOGICAL, 0, NoveltySearchOptions(**options))])
def test_uniform_scenarios_first_then_variations_of_what_was_kept(make):
    search = make(initial=5)
    candidates = [tell_next(search, drive(2.0 + i), verdict(1.0))[0] for i in range(12)]
    assert [candidate.origin for candidate in candidates] == ["initial"] * 5 + ["variation"] * 7
    assert all(candidate.parent < candidate.number for candidate in candidates[5:])


def test_early_scenarios_of_many_in_flight_are_uniform():
    search = elites()
    assert {search.ask().origin for _ in range(9)} == {"initial"}


def test_only_the_novel_is_kept():
    search = NoveltySearch(LOGICAL, 0, NoveltySearchOptions(initial=1, neighbors=1, threshold=0.1))
    learned = [tell_next(search, drive(speed), verdict(1.0))[1] for speed in (3.0, 3.6, 9.0, 9.0)]
    assert [entry["kept"] for entry in learned] == [True, False, True, False]
    assert [entry["distance"] for entry in learned] == pytest.approx([1.0, 0.05, 0.5, 0.0], abs=1e-3)
    assert search.status() == {"archive": 2}


def test_the_degree_does_not_matter_to_novelty():
    search = NoveltySearch(LOGICAL, 0, NoveltySearchOptions(initial=1))
    tell_next(search, drive(5.0), verdict(5.0))
    assert not tell_next(search, drive(5.0), verdict(0.0, failed=True))[1]["kept"]


@pytest.mark.parametrize(("neighbors", "kept"), [(1, False), (2, True)])
def test_novelty_is_the_mean_over_neighbors(neighbors, kept):
    search = NoveltySearch(
        LOGICAL, 0, NoveltySearchOptions(initial=1, neighbors=neighbors, threshold=0.2, measures=("mean-speed",))
    )
    for speed in (1.0, 9.0):
        tell_next(search, drive(speed), verdict(1.0))
    assert tell_next(search, drive(9.0), verdict(1.0))[1]["kept"] is kept


def vary(count=200, **options):
    """Variations of two scenarios, as changes of the genes of the first; shape (count, 5, 17)."""
    search = elites(initial=2, variation=VariationOptions(**options))
    parents = [tell_next(search, drive(speed), verdict(1.0))[0] for speed in (3.0, 9.0)]
    encode = search._asker.encoding.encode
    asked = [search.ask() for _ in range(count)]
    changes = [encode(candidate.scenario) - encode(parents[candidate.parent].scenario) for candidate in asked]
    return np.array(changes).reshape(count, 5, -1)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_some_npcs_stay(share):
    stay = (np.abs(vary(npc_keep_probability=share)) < 1e-9).all(2)
    assert stay.mean() == pytest.approx(share, abs=0.06)


def test_noise_has_its_deviation():
    changes = vary(iso_sigma=0.02, line_sigma=0.0, npc_keep_probability=0.0)[:, :, -6:]  # speeds, not clipped
    assert np.median(np.abs(changes)) == pytest.approx(0.02 * 0.6745, rel=0.15)


def test_variation_lies_on_the_line_between_two():
    plain, along = (vary(iso_sigma=0.001, line_sigma=s, npc_keep_probability=0.0) for s in (0.0, 0.5))
    assert np.abs(along[:, :, -6:]).mean() > 20 * np.abs(plain[:, :, -6:]).mean()


@pytest.mark.parametrize(("method", "module"), [("map-elites", MAPElites), ("novelty-search", NoveltySearch)])
def test_a_missing_pyribs_is_one_sentence(monkeypatch, method, module):
    monkeypatch.setitem(sys.modules, "ribs.archives", None)
    with pytest.raises(InputError, match=rf"'{method}' needs pyribs: install the extra 'search'"):
        module(LOGICAL, 0, module.Options())


@pytest.mark.parametrize(
    ("options", "option", "value"),
    [
        (MAPElitesOptions(), "initial", 0),
        (MAPElitesOptions(), "bins", 0),
        (MAPElitesOptions(), "bins", 2000),
        (MAPElitesOptions(), "measures", ()),
        (NoveltySearchOptions(), "initial", 0),
        (NoveltySearchOptions(), "neighbors", 0),
        (NoveltySearchOptions(), "threshold", -0.1),
        (NoveltySearchOptions(), "measures", ("duration", "duration")),
        (VariationOptions(), "iso_sigma", 0.0),
        (VariationOptions(), "line_sigma", -1.0),
        (VariationOptions(), "npc_keep_probability", 1.0),
    ],
)
def test_options_out_of_range(options, option, value):
    with pytest.raises(InputError, match=option):
        replace(options, **{option: value})
