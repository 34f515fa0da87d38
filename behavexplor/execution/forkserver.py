"""The server process of `multiprocessing`. It imports the modules that workers need, and they are copies of it."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.forkserver import ensure_running, set_forkserver_preload
from types import ModuleType
from typing import Final

import behavexplor
from behavexplor.ads.sb3.description import is_policy

CAN_SHARE: Final = "forkserver" in multiprocessing.get_all_start_methods()
_MAIN: Final = "__main__"
_SAFE_PATH: Final = "PYTHONSAFEPATH"  # variable with which Python does not look into the working folder first


def share_imports(modules: Sequence[str]) -> None:
    """Begin to import modules in the background, where the system can share them. Only the first call has an effect."""
    if not CAN_SHARE:
        return
    set_forkserver_preload(list(modules))
    with clean_start():
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited: Ctrl-C does not end the imports
        try:
            ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def clean_start() -> Iterator[None]:
    """Return a context in which processes start that do not run the user's script, nor modules of the working folder.

    `multiprocessing` imports the script in each new process, because what the process gets may come from there. What a
    worker gets never does, and a script without `if __name__ == "__main__":` would train its policy again. A new
    process also looks for modules in the working folder first, where a random.py would take the place of a library.
    """
    script, safe = sys.modules[_MAIN], os.environ.get(_SAFE_PATH)
    sys.modules[_MAIN], os.environ[_SAFE_PATH] = ModuleType(_MAIN), "1"
    try:
        yield
    finally:
        sys.modules[_MAIN] = script
        del os.environ[_SAFE_PATH]
        if safe is not None:
            os.environ[_SAFE_PATH] = safe


def preloaded_modules(env: str, ads: str) -> tuple[str, ...]:
    """Return what the server process imports for an environment and a driving system, in this order."""
    entry_point = behavexplor.FUNCTIONAL_SCENARIOS.get(env, "behavexplor.envs.highway.drawn_vector_env")
    policy = ("behavexplor.ads.sb3.policy",) if is_policy(ads) and not ads.endswith(".npz") else ()
    lazy = "behavexplor.execution.lazy_imports"  # after PyTorch, which looks into all modules and would load lazy ones
    return *policy, lazy, entry_point.partition(":")[0]
