from collections import Counter

import numpy as np
import pytest

from behavexplor.data.scripted import ScriptedScenario
from behavexplor.fuzz.behavexplor import Corpus, Testcase


def corpus_of(*energies):
    corpus = Corpus()
    for i, energy in enumerate(energies):
        corpus.add(Testcase(10 * i, ScriptedScenario("s", ()), 1.0, i), energy)
    return corpus


def test_testcases_are_found_by_the_number_of_their_candidate():
    corpus = corpus_of(1.0, 2.0)
    assert corpus[10].number == 10
    assert corpus.energy(10) == 2.0
    assert [testcase.number for testcase in corpus] == [0, 10]
    assert len(corpus) == 2


def test_selection_follows_the_energies():
    corpus = corpus_of(1.0, 3.0, -2.0)
    rng = np.random.default_rng(0)
    counts = Counter(corpus.select(rng).number for _ in range(4000))
    assert counts[20] == 0
    assert counts[10] / 4000 == pytest.approx(3 / 4, abs=0.03)


def test_energies_keep_the_order_of_the_testcases_as_the_corpus_grows():
    corpus = corpus_of(*range(100))
    assert corpus.energies.tolist() == list(range(100))


def test_a_changed_energy_counts_at_once():
    corpus = corpus_of(0.0, 1.0)
    corpus.set_energy(0, 1.0)
    corpus.set_energy(10, 0.0)
    assert corpus.select(np.random.default_rng(0)).number == 0


def test_uniform_selection_takes_no_notice_of_energies():
    corpus = corpus_of(1.0, 3.0, -2.0)
    rng = np.random.default_rng(0)
    counts = Counter(corpus.select(rng, uniform=True).number for _ in range(3000))
    assert [counts[number] / 3000 for number in (0, 10, 20)] == pytest.approx([1 / 3] * 3, abs=0.03)
