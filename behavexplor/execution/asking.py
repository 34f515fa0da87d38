"""Asking an ADS for actions: every failure becomes an `ADSError`, and wrong answers are explained."""

import os
from types import SimpleNamespace
from typing import Any, Final

import gymnasium
import numpy as np
from numpy.typing import NDArray

from behavexplor.data.observations import Observation
from behavexplor.errors import brief, described, place_of
from behavexplor.execution.executor import ADSError

COPIED: Final = 84  # exit code of a copy of a worker's process that an ADS has made

_asking: list[Any] = [SimpleNamespace(value=0)]  # 1 while the ADS is being called
_worker: list[int] = []  # the process in which it is called, if that is a worker


def share_asking(flag: Any) -> None:
    """Set the flag whose `value` tells another process, as 1 or 0, whether this process is calling the ADS."""
    _asking[0] = flag
    _worker[:] = [os.getpid()]


def ask(
    ads: Any,
    observation: Observation,
    state: Any,
    start: NDArray[np.bool_],
    space: gymnasium.Space[Any],
    counts: NDArray[np.bool_] | None = None,
) -> tuple[NDArray[Any], Any]:
    """Call an ADS, and return its actions, shape (B, ...), and its state; every failure becomes an `ADSError`.

    An observation has a row for each of B sub-environments with this action space. `start` is True where an episode
    begins, and `counts` for each row whose action is used, shapes (B,); None if all are.

    Raises:
        ADSError: if the ADS fails, or its answer is not a valid action.
    """
    _asking[0].value = 1
    try:
        answer = ads.predict(observation, state, start, deterministic=True)
        return _checked(answer, space, len(start), counts)
    except _AnswerError as error:
        raise ADSError("invalid", _of_function(answer, space) if is_function(ads) else str(error)) from error
    except MemoryError as error:
        raise ADSError("memory", "it ran out of memory") from error
    except SystemExit as error:
        raise ADSError("exit", f"it called sys.exit({error.code!r})") from error
    except (Exception, GeneratorExit) as error:
        raise ADSError("raised", described(error), place_of(error)) from error
    finally:
        if _worker and _worker[0] != os.getpid():
            os._exit(COPIED)  # or each decision would double the number of processes
        _asking[0].value = 0


class _AnswerError(ValueError):
    """The answer of an ADS is not a valid action."""


def is_function(ads: Any) -> bool:
    """Return whether an ADS is a plain function; see `behavexplor.ads.loading`."""
    return getattr(ads, "is_function", False)


def _of_function(answer: Any, space: gymnasium.Space[Any]) -> str:
    """Return what a function must return, in place of an answer that is not valid."""
    return f"the function must return an action of {space}, got {brief(answer[0].tolist()[0])}"


def _checked(
    answer: Any, space: gymnasium.Space[Any], count: int, counts: NDArray[np.bool_] | None
) -> tuple[NDArray[Any], Any]:
    """Return the actions and the state of an answer. If an action is invalid, unused rows take that of a used one."""
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise _AnswerError(f"predict must return a pair (actions, state), got {answer!r:.80}")
    actions = np.asarray(answer[0])
    expected = (count, *(space.shape or ()))
    if actions.shape != expected:
        raise _AnswerError(
            f"predict must return actions of shape {expected}, got {actions.shape}: a row for each observation"
        )
    try:
        _check_values(actions, space)
    except _AnswerError:
        if counts is None:
            raise
        actions = np.where(counts.reshape(-1, *[1] * (actions.ndim - 1)), actions, actions[counts.argmax()])
        _check_values(actions, space)
    return actions, answer[1]


def _check_values(actions: NDArray[Any], space: gymnasium.Space[Any]) -> None:
    """Check actions of the right shape."""
    if actions.dtype.kind not in "iuf" or not np.isfinite(actions).all():
        raise _AnswerError(f"predict must return finite numbers as actions, got {actions!r:.80}")
    if isinstance(space, gymnasium.spaces.Discrete):
        valid = (actions >= space.start) & (actions < space.start + space.n) & (actions.dtype.kind != "f")
        if not valid.all():
            raise _AnswerError(f"predict must return actions of {space}, got {actions[valid.argmin()]}")
