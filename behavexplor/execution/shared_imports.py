"""Fast imports: without garbage collection, and shared by all worker processes.

A server process imports the modules that workers need, and the workers are copies of it.
"""

import gc
import multiprocessing
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.forkserver import ensure_running, set_forkserver_preload
from typing import Final

import behavexplor
from behavexplor.errors import InputError

CAN_SHARE: Final = "forkserver" in multiprocessing.get_all_start_methods()
_FIRST: Final = "behavexplor.execution.imports_begin"
_LAST: Final = "behavexplor.execution.imports_end"
GUARD: Final = 'put what it does under `if __name__ == "__main__":`'


def share_imports(modules: Sequence[str]) -> None:
    """Begin to import modules in the background, where the system can share them. Only the first call has an effect.

    Raises:
        InputError: if this process is a worker that is importing the user's script, and the script would start workers.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise InputError(f"This script starts worker processes when it is imported: {GUARD}")
    if not CAN_SHARE:
        return
    set_forkserver_preload([_FIRST, *modules, _LAST])
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited, so Ctrl-C does not end the imports
    try:
        ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def collections_off() -> Iterator[None]:
    """Turn garbage collection off while modules and drivers are loaded, since these live as long as the process."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def slow_modules(env: str, ads: str) -> tuple[str, ...]:
    """Return the slow modules of an environment and a driving system.

    Args:
        env: name of the environment.
        ads: name of the driving system.
    """
    entry_point = behavexplor.FUNCTIONAL_SCENARIOS.get(env, "behavexplor.envs.highway.drawn_vector_env")
    policy = ("behavexplor.ads.sb3.policy",) if ads.endswith(".zip") else ()
    return *policy, entry_point.partition(":")[0]  # PyTorch first: it looks into all modules, which loads late ones
