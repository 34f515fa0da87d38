"""What is said where the compiled engine is not used."""

from behavexplor.execution.preflight import preflight_warnings
from behavexplor.execution.simulation import Simulation

SHUFFLED = {"observation": {"type": "Kinematics", "order": "shuffled"}, "duration": 2}
PICTURES = {"observation": {"type": "OccupancyGrid"}, "duration": 2}


def test_why_the_engine_is_not_used_is_said_in_words_for_those_who_fuzz():
    reasons = [
        preflight_warnings(Simulation("highway-fast-v0", "constant:IDLE", env_config=config))[0]
        for config in (SHUFFLED, PICTURES)
    ]
    assert all(reason.startswith("highway-env itself executes") for reason in reasons)
    assert "shuffled order" in reasons[0]
    assert reasons[1].endswith("not OccupancyGrid")
