"""The page of an experiment, of campaigns that are made up."""

import re

import numpy as np
import pytest

from behavexplor.bench.comparisons import curves
from behavexplor.bench.experiment import experiment_config
from behavexplor.bench.summaries import Failure, Summary
from behavexplor.bench.tables import tables
from behavexplor.report.experiment_page import _marks, bars, experiment_page
from tests.report.test_report import plain

METHODS = ("Search", "w/o <it> & \u00e9", "Uniform")
ENVS = ("lane-follow", "lane-change")


def experiment(ads=("rule",), seeds=3):
    values = {"name": "made-up", "envs": list(ENVS), "ads": list(ads), "seeds": seeds, "budget": 100}
    methods = {name: {"method": "uniform"} for name in METHODS}
    return experiment_config({**values, "methods": methods, "baseline": "Uniform"})


def campaigns(chosen, rng):
    """A campaign for each run, the first methods failing the more often."""
    return [
        Summary(
            run.env,
            run.ads,
            run.method,
            run.seed,
            100,
            tuple(
                Failure(int(number), "R1", npc_caused=False, kind=f"R1/{number % 7}", signature=f"R1-{number % 8 + 1}")
                for number in np.flatnonzero(rng.random(100) < 0.3 / (1 + METHODS.index(run.method)))
            ),
            0.2,
            8.0,
            2.0,
        )
        for run in chosen.runs()
    ]


def made(chosen, summaries):
    return experiment_page(chosen, summaries, tables(chosen, summaries), curves(chosen, summaries))


@pytest.fixture(scope="module")
def whole():
    chosen = experiment()
    summaries = campaigns(chosen, np.random.default_rng(0))
    return chosen, summaries, made(chosen, summaries)


def test_the_page_has_every_table_and_every_campaign(whole):
    chosen, summaries, text = whole
    page = plain(text)
    names = [table.name for table in tables(chosen, summaries)]
    assert {"violations", "distinct", "weaknesses", "unique-uniform"} <= set(names)
    assert all(f'<h2 id="{name}">' in text and f'href="#{name}"' in text for name in names)
    assert "All 18 campaigns are finished." in page
    assert "runs/lane-change/rule/w-o-it-&#233;/3" in page
    mean = np.mean([len(s.failures) for s in summaries if (s.env, s.method) == ("lane-follow", "Search")])
    assert f"{mean:.1f} [" in page
    assert "not distinguishable" in page


def test_charts_are_one_of_each_kind_for_each_figure_and_place(whole):
    _, _, text = whole
    figures = 5  # failures at fault, their classes, unique violations, failures and weaknesses
    assert text.count('<circle class="mean"') == figures * len(ENVS) * len(METHODS)
    assert text.count(' over executions"') == text.count(': means and intervals"') == figures * len(ENVS)
    assert text.count('class="legend"') == figures


def test_places_name_the_ads_where_there_are_several():
    chosen = experiment(("rule", "idm"))
    page = plain(made(chosen, campaigns(chosen, np.random.default_rng(1))))
    assert "lane-change, idm" in page
    assert "All 36 campaigns" in page


def test_part_of_an_experiment_is_said_to_be_one():
    chosen = experiment()
    summaries = campaigns(chosen, np.random.default_rng(2))[:4]  # one campaign has no interval
    page = plain(made(chosen, summaries))
    assert "4 of 18 campaigns are finished, and this page shows only these." in page
    assert "nan" not in page


def test_campaigns_without_any_failure_have_a_page():
    chosen = experiment(seeds=1)
    none = [Summary(run.env, run.ads, run.method, 1, 100, (), 0.2, 8.0, 2.0) for run in chosen.runs()]
    assert "All 6 campaigns" in plain(made(chosen, none))


def test_names_are_text_and_the_page_is_ascii_and_asks_for_nothing(whole):
    _, _, text = whole
    assert text.isascii()
    assert "w/o &lt;it&gt; &amp; &#233;" in text
    assert "<it>" not in text
    assert not re.findall(r"(?:src|href)=\"(?!#|data:)", text)
    assert "default-src &#39;none&#39;" in text


def test_equal_experiments_have_equal_pages(whole):
    chosen, summaries, text = whole
    assert made(chosen, summaries) == text


def test_bars_span_the_interval_and_stay_in_the_chart(whole):
    chosen, summaries, _ = whole
    group = [c for c in curves(chosen, summaries) if (c.figure, c.env) == ("failures", "lane-follow")]
    other = [c for c in curves(chosen, summaries) if (c.figure, c.env) == ("failures", "lane-change")]
    marks = _marks([*group, *other])
    drawn = bars("failures", group, marks)
    assert drawn.x_ticks == bars("failures", other, marks).x_ticks
    for bar, curve in zip(drawn.bars, group, strict=True):
        assert len(bar.dots) == len(set(curve.ends))
        assert all(118 <= dot <= 350 for dot in bar.dots)
        assert 118 <= bar.low <= bar.x <= bar.high <= 350
        assert bar.low < bar.high
    assert [bar.name for bar in drawn.bars] == list(METHODS)
    assert [bar.x for bar in drawn.bars] == sorted((bar.x for bar in drawn.bars), reverse=True)
    assert drawn.height > drawn.bars[-1].y
