"""The server process of `multiprocessing`, which imports modules once for all worker processes, its copies."""

import multiprocessing
import signal
from collections.abc import Sequence
from multiprocessing import resource_tracker
from multiprocessing.forkserver import ensure_running, set_forkserver_preload
from multiprocessing.spawn import get_preparation_data
from typing import Final

import behavexplor
from behavexplor.errors import InputError

CAN_SHARE: Final = "forkserver" in multiprocessing.get_all_start_methods()
GUARD: Final = 'put what it does under `if __name__ == "__main__":`'


def share_imports(modules: Sequence[str]) -> None:
    """Begin to import modules in the background, where the system can share them. Only the first call has an effect.

    Raises:
        InputError: if this process is a worker that is importing the user's script, and the script would start workers.
    """
    try:
        get_preparation_data("")
    except RuntimeError:
        raise InputError(f"This script starts worker processes when it is imported: {GUARD}") from None
    if not CAN_SHARE:
        return
    set_forkserver_preload(list(modules))
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited, so Ctrl-C does not end the imports
    try:
        ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def slow_modules(env: str, ads: str) -> tuple[str, ...]:
    """Return the slow modules of an environment and a driving system.

    Args:
        env: name of the environment.
        ads: name of the driving system.
    """
    entry_point = behavexplor.FUNCTIONAL_SCENARIOS.get(env, "behavexplor.envs.highway.drawn_vector_env")
    policy = ("behavexplor.ads.sb3.policy",) if ads.endswith(".zip") else ()
    lazy = "behavexplor.execution.lazy_imports"  # after PyTorch, which looks into all modules and so loads them
    return *policy, lazy, entry_point.partition(":")[0]
