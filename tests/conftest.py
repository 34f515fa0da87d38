"""Settings of all tests."""

import signal
from multiprocessing import set_forkserver_preload

import pytest
from hypothesis import settings

from behavexplor.envs.engine.vehicle_parameters import parameters, set_parameters

SLOW_IMPORTS = ["behavexplor.ads.sb3.policy", "behavexplor.envs.highway.drawn_vector_env"]

settings.register_profile("untimed", deadline=None)  # machines are shared: the first call of a kernel compiles it
settings.load_profile("untimed")

VEHICLES = parameters()

for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) is signal.SIG_IGN:  # in the background, so programs of tests would inherit it
        signal.signal(number, handler)


@pytest.fixture(autouse=True, scope="session")
def imports_of_workers():
    """Let the workers of all tests share what any of them imports; the process that they are forked from is one."""
    with pytest.MonkeyPatch.context() as patch:
        preload = "behavexplor.execution.forkserver.set_forkserver_preload"
        patch.setattr(preload, lambda names: set_forkserver_preload([*names, *SLOW_IMPORTS]))
        yield


@pytest.fixture(autouse=True, scope="session")
def list_of_own_folders(tmp_path_factory):
    """Keep the user's own state as it is: what tests make is listed elsewhere, also by the programs that they start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(autouse=True)
def vehicles_of_highway_env() -> None:
    """Begin each test with highway-env's own vehicles, which its intersection changes for the whole process."""
    set_parameters(VEHICLES)


@pytest.fixture
def canary(tmp_path):
    """A file of the user beside a folder, which must stay as it is."""
    path = tmp_path / "canary"
    path.write_text("precious")
    yield path
    assert path.read_text() == "precious"
