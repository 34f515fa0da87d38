from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from behavexplor.data.scenario import Noise
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.data.scripted_logical import shift_waypoints
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError

LOGICAL = IntersectionStraightEnv.logical

CROWDED = replace(LOGICAL, n_npcs=20)
NOISE = Noise(0.5, 12.0, 6.0, 0.1)


class FixedNormal:
    """Noise that was chosen by hand."""

    def __init__(self, noise, draws=0.5):
        self.noise = np.array(noise, dtype=float)
        self.draws = draws

    def random(self, shape):
        return np.broadcast_to(np.reshape(self.draws, (-1, 1)), shape)

    def normal(self, mean, sigma, shape):
        assert mean == 0
        assert shape == self.noise.shape
        return self.noise * sigma


def npc_on(route, positions, speeds):
    return NPC("sedan", route, tuple(map(Waypoint, positions, speeds)))


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    kind=st.sampled_from(["waypoints", "routes"]),
    logical=st.sampled_from([LOGICAL, CROWDED, replace(LOGICAL, n_npcs=1)]),
    sigma=st.sampled_from([0.1, 12.0, 500.0]),
    keep=st.sampled_from([0.0, 0.5, 0.95]),
)
def test_a_mutant_is_valid_and_not_its_parent(seed, kind, logical, sigma, keep):
    rng = np.random.default_rng(seed)
    parent = logical.sample(rng)
    before = parent.to_json()
    if kind == "waypoints":
        mutant = logical.mutate_little(parent, rng, Noise(keep, sigma, sigma / 2, 0.1))
    else:
        mutant = logical.mutate_much(parent, rng, keep)
    logical.check(mutant)
    assert mutant != parent
    assert parent.to_json() == before
    assert len(mutant.npcs) == len(parent.npcs)
    if kind == "waypoints":
        assert [(npc.type, npc.route) for npc in mutant.npcs] == [(npc.type, npc.route) for npc in parent.npcs]


def test_a_long_line_of_mutants_stays_valid():
    rng = np.random.default_rng(1)
    scenario = CROWDED.sample(rng)
    for i in range(60):
        if i % 10 == 9:
            scenario = CROWDED.mutate_much(scenario, rng, 0.5)
        else:
            scenario = CROWDED.mutate_little(scenario, rng, NOISE)
        CROWDED.check(scenario)


@pytest.mark.parametrize("kind", ["waypoints", "routes"])
@pytest.mark.parametrize("keep", [0.2, 0.5, 0.8])
def test_each_npc_is_mutated_with_probability_one_minus_epsilon(kind, keep):
    rng = np.random.default_rng(2)
    parent = CROWDED.sample(rng)
    changed = 0
    for _ in range(60):
        if kind == "waypoints":
            mutant = CROWDED.mutate_little(parent, rng, replace(NOISE, keep_probability=keep))
        else:
            mutant = CROWDED.mutate_much(parent, rng, keep)
        changed += sum(a != b for a, b in zip(mutant.npcs, parent.npcs, strict=True))
    assert changed / (60 * 20) == pytest.approx(1 - keep, abs=0.04)


def test_noise_by_hand():
    """North, outer lane: 120 m approach, 30 m connector, 75 m exit, 80 m on; two waypoints on each."""
    npc = npc_on("north-outer-straight", [20, 90, 125, 140, 160, 200, 230, 300], [5, 6, 7, 8, 9, 10, 11, 0])
    noise = [(1, 0.5), (-2, 1), (1, -1), (3, -2), (0, 0), (-0.5, 0.1), (-1, 3), (1, 2)]
    mutant = shift_waypoints(npc, LOGICAL, FixedNormal(noise), NOISE)
    expected = [20 + 12, 90 - 24, 125 + 12, 150, 160, 200 - 6, 225, 305]  # 140 + 36, 230 - 12 and 312 leave their lanes
    speeds = [5 + 3, 11.176, 7 - 6, 0.2, 9, 10 + 0.6, 11.176, 0]
    assert [point.position for point in mutant.waypoints] == pytest.approx(expected)
    assert [point.speed for point in mutant.waypoints] == pytest.approx(speeds)
    assert (mutant.type, mutant.route) == (npc.type, npc.route)


def test_waypoints_that_overtake_change_places():
    npc = npc_on("north-outer-straight", [50, 60, 125, 140, 160, 200, 230, 300], [5] * 7 + [0])
    noise = np.zeros((8, 2))
    noise[0, 0] = 2
    mutant = shift_waypoints(npc, LOGICAL, FixedNormal(noise), NOISE)
    assert [point.position for point in mutant.waypoints[:2]] == [60, 74]


@pytest.mark.parametrize(("noise", "first", "second"), [(-100, 2.5, 2.5), (100, 117.5, 120)])
def test_starts_keep_clear_of_the_ends_of_their_lane(noise, first, second):
    npc = npc_on("north-outer-straight", [50, 60, 125, 140, 160, 200, 230, 300], [5] * 7 + [0])
    shift = np.zeros((8, 2))
    shift[:2, 0] = noise
    mutant = shift_waypoints(npc, LOGICAL, FixedNormal(shift), NOISE)
    assert [point.position for point in mutant.waypoints[:2]] == [first, second]


def test_some_waypoints_may_stay():
    npc = npc_on("north-outer-straight", [50, 60, 125, 140, 160, 200, 230, 300], [5] * 7 + [0])
    rng = FixedNormal(np.full((8, 2), 0.1), draws=[0.2, 0.7, 0.7, 0.2, 0.5, 0.49, 0.9, 0.1])
    mutant = shift_waypoints(npc, LOGICAL, rng, Noise(0.5, 10.0, 1.0, 0.1, 0.5))
    assert [point.position for point in mutant.waypoints] == pytest.approx([50, 61, 126, 140, 161, 200, 231, 300])
    assert [point.speed for point in mutant.waypoints] == pytest.approx([5, 5.1, 5.1, 5, 5.1, 5, 5.1, 0])


def test_noise_has_the_stated_deviations():
    middle = npc_on("north-outer-straight", [60, 60, 135, 135, 187, 187, 265, 265], [5.7] * 7 + [0])
    rng = np.random.default_rng(3)
    mutants = [shift_waypoints(middle, LOGICAL, rng, Noise(0.5, 12.0, 1.0, 0.1)) for _ in range(2000)]
    first_two = np.array([[point.position for point in mutant.waypoints[:2]] for mutant in mutants]) - 60
    assert first_two.std() == pytest.approx(12, rel=0.05)
    assert first_two.mean() == pytest.approx(0, abs=0.5)
    assert np.std([mutant.waypoints[0].speed for mutant in mutants]) == pytest.approx(1, rel=0.05)


def test_a_new_route_has_uniform_waypoints_and_type():
    rng = np.random.default_rng(4)
    parent = LOGICAL.sample(rng)
    mutants = [LOGICAL.mutate_much(parent, rng, 0.0) for _ in range(300)]
    routes = {npc.route for mutant in mutants for npc in mutant.npcs}
    types = {npc.type for mutant in mutants for npc in mutant.npcs}
    assert routes == set(LOGICAL.roadmap.routes)
    assert types == set(LOGICAL.vehicle_types)


def test_the_same_draws_give_the_same_mutant():
    parent = LOGICAL.sample(np.random.default_rng(5))
    first, second = (LOGICAL.mutate_little(parent, np.random.default_rng(6), NOISE) for _ in range(2))
    assert first == second


def test_nothing_to_mutate_is_said():
    empty = ScriptedScenario(LOGICAL.name, ())
    with pytest.raises(InputError, match="0 NPCs"):
        LOGICAL.mutate_much(empty, np.random.default_rng(0), 0.5)
