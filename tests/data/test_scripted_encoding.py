"""Scenarios as vectors: every point can be run, and every scenario is a point."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from behavexplor.data.roadmap import Route
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.scripted_logical import ROUTE, START, TYPE, ScriptedEncoding
from behavexplor.envs.functional import IntersectionStraightEnv, LaneChangeEnv, LaneFollowEnv
from behavexplor.errors import InputError
from tests.strategies import seeds

LOGICAL = IntersectionStraightEnv.logical
PLACES = [LOGICAL, LaneFollowEnv.logical, LaneChangeEnv.logical]

EVERYWHERE = pytest.mark.parametrize("logical", PLACES, ids=lambda logical: logical.name)


def close(one, other):
    """Whether scenarios are the same up to rounding."""
    if [(npc.type, npc.route) for npc in one.npcs] != [(npc.type, npc.route) for npc in other.npcs]:
        return False
    pairs = [
        (point.position - twin.position, point.speed - twin.speed)
        for npc, same in zip(one.npcs, other.npcs, strict=True)
        for point, twin in zip(npc.waypoints, same.waypoints, strict=True)
    ]
    return bool(np.abs(pairs).max() < 1e-5)


@EVERYWHERE
@settings(max_examples=60, deadline=None)
@given(seed=seeds)
def test_sampled_scenarios_survive_the_round_trip(logical, seed):
    encoding, scenario = ScriptedEncoding(logical), logical.sample(np.random.default_rng(seed))
    vector = encoding.encode(scenario)
    assert vector.shape == (encoding.size,)
    assert ((vector >= 0) & (vector <= 1)).all()
    assert close(encoding.decode(vector), scenario)


@EVERYWHERE
@settings(max_examples=60, deadline=None)
@given(seed=seeds, crowded=st.booleans())
def test_every_point_is_a_scenario_that_can_be_run(logical, seed, crowded):
    encoding, rng = ScriptedEncoding(logical), np.random.default_rng(seed)
    vector = rng.random(encoding.size)
    if crowded:  # all in one lane, at one place
        blocks = vector.reshape(encoding.n_blocks, -1)
        blocks[:, [ROUTE, START]] = rng.random(2)
    scenario = encoding.decode(vector)
    logical.check(scenario)
    assert encoding.decode(vector) == scenario
    assert encoding.decode(encoding.encode(scenario)) == scenario


@EVERYWHERE
@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_corners_are_scenarios(logical, value):
    logical.check(ScriptedEncoding(logical).decode(np.full(ScriptedEncoding(logical).size, value)))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=85, max_size=85))
def test_values_beyond_the_range_count_as_its_ends(values):
    encoding = ScriptedEncoding(LOGICAL)
    assert encoding.decode(np.array(values)) == encoding.decode(np.clip(values, 0, 1))


def test_points_are_as_uniform_as_the_sampler():
    """On lanes where hardly any is repaired: the sampler draws whole NPCs again, which makes others likelier."""
    encoding, rng = ScriptedEncoding(LOGICAL), np.random.default_rng(0)
    decoded = [encoding.decode(rng.random(encoding.size)) for _ in range(400)]
    sampled = [LOGICAL.sample(rng) for _ in range(400)]
    for figure in (
        lambda npc: npc.type == "sedan",
        lambda npc: npc.route.endswith("left"),
        lambda npc: npc.waypoints[0].position,
        lambda npc: npc.waypoints[3].position,
        lambda npc: npc.waypoints[2].speed,
    ):
        one, other = (
            [figure(npc) for scenario in group for npc in scenario.npcs if npc.route.startswith("west")]
            for group in (decoded, sampled)
        )
        assert np.mean(one) == pytest.approx(np.mean(other), abs=4 * np.std(other) * np.sqrt(2 / len(other)))


def test_each_gene_is_used():
    encoding = ScriptedEncoding(LOGICAL)
    vector = np.full(encoding.size, 0.3)
    plain = encoding.decode(vector)
    for gene in range(encoding.size):
        changed = vector.copy()
        changed[gene] = 0.9
        assert encoding.decode(changed) != plain


def test_genes_mean_what_they_say():
    encoding = ScriptedEncoding(LOGICAL)
    blocks = np.full((encoding.n_blocks, encoding.n_genes), 0.5)
    blocks[:, ROUTE] = np.arange(5) / 5
    blocks[0, TYPE], blocks[0, ROUTE], blocks[0, START] = 0.0, 0.99, 0.25
    blocks[0, encoding.speed_genes[0]] = 1.0
    npc = encoding.decode(blocks.ravel()).npcs[0]
    assert npc.type == LOGICAL.vehicle_types[0]
    assert npc.route == LOGICAL.roadmap.npc_routes[-1].name
    low, high = LOGICAL.position_ranges(LOGICAL.roadmap.routes[npc.route])[0]
    assert npc.waypoints[0].position == pytest.approx(low + 0.25 * (high - low))
    assert npc.waypoints[0].speed == LOGICAL.speed_range[1]
    assert npc.waypoints[-1].speed == 0


def test_repair_takes_the_nearest_free_place_of_the_lane():
    encoding = ScriptedEncoding(replace(LOGICAL, n_npcs=2))
    blocks = np.full((2, encoding.n_genes), 0.5)
    blocks[:, ROUTE] = 0.99  # east, far from the ego
    first, second = encoding.decode(blocks.ravel()).npcs
    assert first.route == second.route
    gap = abs(first.waypoints[0].position - second.waypoints[0].position)
    low, high = LOGICAL.position_ranges(LOGICAL.roadmap.routes[first.route])[0]
    assert 8.0 <= gap <= 8.0 + 4.7 + (high - low) / 64


def test_repair_goes_on_to_the_next_lane_if_one_is_full():
    logical = replace(LaneFollowEnv.logical, npc_gap=100.0, n_npcs=9)
    scenario = ScriptedEncoding(logical).decode(np.zeros(ScriptedEncoding(logical).size))
    logical.check(scenario)
    assert len({npc.route for npc in scenario.npcs}) > 1


def test_no_place_is_said():
    logical = replace(LOGICAL, npc_gap=500.0, n_npcs=12)
    with pytest.raises(InputError, match="no place for 12 NPCs; use fewer"):
        ScriptedEncoding(logical).decode(np.zeros(ScriptedEncoding(logical).size))


@pytest.mark.parametrize("vector", [np.zeros(84), np.zeros((5, 17)), np.full(85, np.nan)])
def test_wrong_vectors_are_refused(vector):
    with pytest.raises(InputError, match="expected 85 finite numbers"):
        ScriptedEncoding(LOGICAL).decode(vector)


def test_too_few_npcs_are_refused():
    scenario = LOGICAL.sample(np.random.default_rng(0))
    with pytest.raises(InputError, match="expected 5, got 4"):
        ScriptedEncoding(LOGICAL).encode(ScriptedScenario(LOGICAL.name, scenario.npcs[:4]))


def test_routes_of_other_lengths_leave_genes_unused():
    short, *others = LOGICAL.roadmap.npc_routes
    short = Route(short.name, short.lanes[:2])
    logical = replace(LOGICAL, roadmap=replace(LOGICAL.roadmap, npc_routes=(short, *others)), n_npcs=1)
    encoding = ScriptedEncoding(logical)
    vector = np.full(encoding.size, 0.3)
    vector[ROUTE] = 0.0
    scenario = encoding.decode(vector)
    logical.check(scenario)
    assert len(scenario.npcs[0].waypoints) < encoding.decode(np.full(encoding.size, 0.9)).npcs[0].waypoints.__len__()
    assert close(encoding.decode(encoding.encode(scenario)), scenario)
    assert encoding.encode(scenario)[encoding.speed_genes[-1]] == 0.5


def test_features_put_different_categories_at_distance_1():
    encoding = ScriptedEncoding(LOGICAL)
    vectors = np.full((3, encoding.size), 0.5)
    vectors[1, ROUTE], vectors[2, ROUTE] = 0.6, 0.99
    features = encoding.features(vectors)
    assert features.shape == (3, 5 * (5 + 16 + 15))
    apart = np.linalg.norm(features[:, None] - features[None], axis=2)
    assert apart[~np.eye(3, dtype=bool)] == pytest.approx(np.ones(6))


def test_features_keep_other_distances():
    encoding = ScriptedEncoding(LOGICAL)
    vectors = np.full((2, encoding.size), 0.5)
    vectors[1, START] = 0.9
    assert np.linalg.norm(np.diff(encoding.features(vectors), axis=0)) == pytest.approx(0.4)
