"""A generator that plays and records draws, beside numpy's own."""

import numpy as np
import pytest

from behavexplor.envs.highway.generator import DrawnGenerator
from behavexplor.errors import InputError

DRAWS = {
    "random": lambda rng: rng.random(),
    "random of a shape": lambda rng: rng.random((2, 3)),
    "uniform": lambda rng: rng.uniform(-3.0, 5.0),
    "uniform of a size": lambda rng: rng.uniform(size=4),
    "uniform with bounds by name": lambda rng: rng.uniform(high=3.0),
    "uniform with arrays of bounds": lambda rng: rng.uniform(np.zeros(3), np.array([1.0, 2.0, 3.0])),
    "normal": lambda rng: rng.normal(),
    "normal with parameters": lambda rng: rng.normal(1.0, 2.5),
    "normal of a size": lambda rng: rng.normal(0.0, 2.0, size=3),
    "standard normal": lambda rng: rng.standard_normal(2),
    "integers": lambda rng: rng.integers(5),
    "integers in a range": lambda rng: rng.integers(2, 9),
    "integers up to an end": lambda rng: rng.integers(1, 6, endpoint=True),
    "integers of a size": lambda rng: rng.integers(0, 100, size=5),
    "one possibility": lambda rng: rng.integers(1),
    "a choice of numbers": lambda rng: rng.choice(7),
    "a choice of things": lambda rng: rng.choice(["north", "south", "west"]),
    "choices": lambda rng: rng.choice(range(4), size=3),
    "choices without replacement": lambda rng: rng.choice(range(4), size=2, replace=False),
    "a weighted choice": lambda rng: rng.choice(3, p=[0.2, 0.5, 0.3]),
    "a weighted choice of one": lambda rng: rng.choice(range(3), size=1, p=[0.6, 0.3, 0.1]),
    "a permutation": lambda rng: rng.permutation(6),
    "shuffled": lambda rng: shuffled(rng, np.arange(12.0)),
    "shuffled rows": lambda rng: shuffled(rng, np.arange(12.0).reshape(6, 2)),
}


def shuffled(rng, values):
    rng.shuffle(values)
    return values


@pytest.mark.parametrize("draw", DRAWS.values(), ids=DRAWS.keys())
def test_recorded_draws_are_numpys_and_played_ones_are_equal_to_the_last_bit(draw):
    for seed in range(40):
        recording = DrawnGenerator({}, np.random.default_rng(seed), "nowhere.py")
        plain = np.random.default_rng(seed)
        recorded = [draw(recording) for _ in range(3)]
        assert [np.asarray(value).tolist() for value in recorded] == [
            np.asarray(draw(plain)).tolist() for _ in range(3)
        ]
        assert type(recorded[0]) is type(draw(plain))
        playing = DrawnGenerator(recording.drawn, 99, "nowhere.py")
        assert [np.asarray(draw(playing)).tolist() for _ in range(3)] == [
            np.asarray(value).tolist() for value in recorded
        ]


def test_after_recording_numpys_generator_goes_on_as_if_it_had_drawn_itself():
    source, plain = np.random.default_rng(5), np.random.default_rng(5)
    recording = DrawnGenerator({}, source, "nowhere.py")
    for draw in DRAWS.values():
        draw(recording)
        draw(plain)
    assert source.random() == plain.random()


def first(rng):
    return rng.random()


def second(rng, count):
    return [rng.random() for _ in range(count)]


def scene(rng, count):
    return first(rng), second(rng, count), second(rng, 1), first(rng)


def test_draws_are_named_by_their_calls():
    rng = DrawnGenerator({}, 1, "nowhere.py")
    scene(rng, 2)
    names = {
        name.rpartition("test_draws_are_named_by_their_calls/")[2]: len(drawn) for name, drawn in rng.drawn.items()
    }
    assert names == {"scene/first": 1, "scene/second": 2, "scene/second#1": 1, "scene/first#1": 1}


def test_a_draw_does_not_depend_on_how_many_others_are_made():
    few, many = (scene(DrawnGenerator({}, 1, "nowhere.py"), count) for count in (1, 5))
    assert few[0] == many[0]
    assert few[1] == many[1][:1]
    assert few[2:] == many[2:]
    assert scene(DrawnGenerator({}, 2, "nowhere.py"), 1) != few


def test_given_draws_are_played_and_the_others_come_from_the_seed():
    plain = DrawnGenerator({}, 1, "nowhere.py")
    made = scene(plain, 2)
    given = {name: [0.125] for name in plain.drawn if name.endswith("second")}
    changed = scene(DrawnGenerator(given, 1, "nowhere.py"), 2)
    assert changed[1] == [0.125, made[1][1]]
    assert changed[0] == made[0]


def test_a_share_of_a_choice_selects_it():
    def chosen(share):
        rng = DrawnGenerator({}, 0, "nowhere.py")
        rng.choice(4)
        return DrawnGenerator({next(iter(rng.drawn)): [share]}, 0, "nowhere.py").choice(4)

    assert [chosen(share) for share in (0.0, 0.24, 0.25, 0.76, 0.999999)] == [0, 0, 1, 3, 3]


@pytest.mark.parametrize(
    "draw",
    [
        lambda rng: rng.beta(1, 2),
        lambda rng: rng.spawn(2),
        lambda rng: rng.exponential(),
        lambda rng: rng.random(3, dtype=np.float32),
        lambda rng: rng.integers([1, 2], [3, 4]),
        lambda rng: rng.shuffle(np.zeros((2, 2)), axis=1),
    ],
)
def test_other_draws_are_refused_by_name(draw):
    with pytest.raises(InputError, match=r"draws by .* of numpy.random.Generator, which cannot be recorded"):
        draw(DrawnGenerator({}, 0, "nowhere.py"))


def test_a_given_normal_number_is_no_position_in_a_range():
    """Where an environment's earlier draws decide which kind it makes next."""

    def three(rng):
        return rng.integers(4), rng.random(), rng.integers(4)

    plain = DrawnGenerator({}, 7, "nowhere.py")
    made = three(plain)
    given = {next(iter(plain.drawn)): [-1.5, 2.5, 0.75]}
    assert three(DrawnGenerator(given, 7, "nowhere.py")) == (*made[:2], 3)
