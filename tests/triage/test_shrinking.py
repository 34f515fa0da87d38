"""The search for the simplest scenario, with properties that are plain functions of its parts."""

from dataclasses import dataclass, field

from hypothesis import given
from hypothesis import strategies as st

from behavexplor.data.scenario import Part, Size
from behavexplor.triage.shrinking import shrink, size_of


@dataclass
class Holds:
    """A property that is a function of parts, and counts how often it is asked."""

    of: object
    keeps: object = field(default=lambda _: True)
    asked: list = field(default_factory=list)

    def held_by(self, candidates):
        self.asked += candidates
        return [self.of(candidate) for candidate in candidates]

    def kept_by(self, candidate):
        return self.keeps(candidate)


def part(label, *values):
    return Part(label, values)


def labels(parts):
    return [one.label for one in parts]


PARTS = tuple(part(name, 1.234567, 2.5, 3.0) for name in "abcdef")


def test_parts_that_do_not_matter_are_removed_and_values_become_plain():
    held = Holds(lambda parts: "b" in labels(parts) and "e" in labels(parts))
    shrunk = shrink(PARTS, held, removable=True, limit=500)
    assert shrunk.parts == (part("b", None, None, None), part("e", None, None, None))
    assert shrunk.is_minimal
    assert shrunk.executions == len(held.asked) == len(set(held.asked)), "no candidate is executed twice"


def test_values_that_matter_stay_and_are_rounded_as_far_as_they_can():
    def fails(parts):
        return any(one.label == "c" and (one.values[0] or 0.0) > 1.2 for one in parts)

    shrunk = shrink(PARTS, Holds(fails), removable=True, limit=500)
    assert shrunk.parts == (part("c", 1.23, None, None),)


def test_parts_that_cannot_be_removed_become_plain():
    def fails(parts):
        return len(parts) == len(PARTS) and parts[3].values[1] == 2.5

    shrunk = shrink(PARTS, Holds(fails), removable=False, limit=500)
    assert labels(shrunk.parts) == list("abcdef")
    assert size_of(shrunk.parts, removable=False) == Size(1, 1)
    assert size_of(shrunk.parts, removable=True) == Size(6, 1)


def test_a_limit_ends_the_search_and_is_told():
    held = Holds(lambda parts: len(parts) >= 4)
    shrunk = shrink(PARTS, held, removable=True, limit=30)
    assert len(held.asked) == shrunk.executions == 30
    assert not shrunk.is_minimal
    assert held.of(shrunk.parts)


def test_a_failure_that_is_not_reproduced_stays_as_it_is():
    shrunk = shrink(PARTS, Holds(lambda _: False), removable=True, limit=0)
    assert shrunk.parts == PARTS
    assert shrunk.executions == 0


def test_what_must_be_kept_is_asked_only_of_what_would_be_accepted():
    kept = []

    def keeps(parts):
        kept.append(parts)
        return "a" in labels(parts)

    held = Holds(lambda parts: "f" in labels(parts), keeps)
    shrunk = shrink(PARTS, held, removable=True, limit=500)
    assert labels(shrunk.parts) == ["a", "f"]
    assert len(kept) < len(held.asked) / 4


VALUES = st.one_of(st.none(), st.floats(0, 9), st.sampled_from(["suv", "jeep"]))


@given(
    parts=st.lists(st.tuples(st.sampled_from("abcd"), st.tuples(VALUES, VALUES)), min_size=1, max_size=8),
    needed=st.sets(st.sampled_from("abcd")),
    least=st.integers(0, 4),
)
def test_the_result_has_the_property_and_loses_it_without_any_one_part(parts, needed, least):
    given_parts = tuple(Part(label, values) for label, values in parts)

    def fails(parts):
        return needed & set(labels(given_parts)) <= set(labels(parts)) and sum(one.free for one in parts) >= least

    if not fails(given_parts):
        return
    found = shrink(given_parts, Holds(fails), removable=True, limit=5000)
    assert fails(found.parts)
    assert found.is_minimal
    assert not any(fails(found.parts[:i] + found.parts[i + 1 :]) for i in range(len(found.parts)))
    assert shrink(found.parts, Holds(fails), removable=True, limit=5000).parts == found.parts
