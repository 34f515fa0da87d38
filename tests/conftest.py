"""Settings of all tests."""

import pytest
from hypothesis import settings

from behavexplor.envs.drawn.vehicle_classes import parameters, set_parameters

settings.register_profile("untimed", deadline=None)  # machines are shared: the first call of a kernel compiles it
settings.load_profile("untimed")

VEHICLES = parameters()


@pytest.fixture(autouse=True)
def vehicles_of_highway_env() -> None:
    """Begin each test with highway-env's own vehicles, which its intersection changes for the whole process."""
    set_parameters(VEHICLES)
