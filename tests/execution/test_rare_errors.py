"""A driver that fails now and then in the compiled engine, and what is said where the engine is not used."""

import numpy as np
import pytest

from behavexplor.data.target import Target
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.preflight import preflight_warnings
from behavexplor.execution.rollout import ADSError
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import start_executor

SHUFFLED = {"observation": {"type": "Kinematics", "order": "shuffled"}, "duration": 2}
PICTURES = {"observation": {"type": "OccupancyGrid"}, "duration": 2}


class Rarely:
    """Fails once, and never again."""

    def __init__(self):
        self.calls = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        if self.calls == 3:
            raise RuntimeError("a rare one")
        return np.array([4]), state


def test_a_failure_that_would_not_happen_again_is_not_lost():
    target = Target("highway-fast-v0", "tests.execution.test_rare_errors:Rarely", unconfined=True)
    data = Simulation("highway-fast-v0", Rarely()).logical.sample(np.random.default_rng(0)).to_json().encode()
    with start_executor(target, 0) as executor, pytest.raises(ADSError, match="a rare one"):
        executor.submit(EXECUTE, data).result()


def test_why_the_engine_is_not_used_is_said_in_words_for_those_who_fuzz():
    reasons = [
        preflight_warnings(Simulation("highway-fast-v0", "constant:IDLE", env_config=config))[0]
        for config in (SHUFFLED, PICTURES)
    ]
    assert all(reason.startswith("highway-env itself executes") for reason in reasons)
    assert "shuffled order" in reasons[0]
    assert reasons[1].endswith("not OccupancyGrid")
