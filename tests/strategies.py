"""Random values for property tests."""

import numpy as np
from hypothesis import strategies as st

from behavexplor.logical import LogicalScenario
from behavexplor.scenario import Scenario
from behavexplor.trace import ENDS, Trace

seeds = st.integers(0, 2**32 - 1)


def scenarios(logical: LogicalScenario) -> st.SearchStrategy[Scenario]:
    return seeds.map(lambda seed: logical.sample(np.random.default_rng(seed)))


def random_trace(seed: int, frames: int = 20, npcs: int = 3, decisions: int = 10) -> Trace:
    """A trace of vehicles that wander about; nothing in it is meant to be physical."""
    rng = np.random.default_rng(seed)
    vehicles = 1 + npcs
    return Trace(
        time=np.arange(frames) * 0.05,
        position=np.cumsum(rng.normal(0, 1, (frames, vehicles, 2)), axis=0) + rng.normal(0, 8, (vehicles, 2)),
        heading=np.cumsum(rng.normal(0, 0.1, (frames, vehicles)), axis=0) + rng.uniform(-4, 4, vehicles),
        velocity=rng.normal(0, 5, (frames, vehicles, 2)),
        size=rng.uniform(1.5, 9, (vehicles, 2)),
        actions=rng.uniform(-1, 1, (decisions, 2)),
        action_frame=np.sort(rng.integers(0, frames, decisions)),
        route=np.stack([np.linspace(0, 50, 51), np.zeros(51)], axis=1),
        destination=rng.normal(0, 30, 2),
        illegal_lines=rng.normal(0, 15, (6, 2, 2)),
        end=ENDS[rng.integers(len(ENDS))],
        decisions={"code": rng.integers(0, 5, decisions).astype(float)},
    )
