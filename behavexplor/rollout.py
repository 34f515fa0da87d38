"""Episodes: an ADS drives concrete scenarios in an environment, one after the other or many in lock-step."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from behavexplor.scenario import Scenario
from behavexplor.trace import Trace


class ADSError(Exception):
    """An ADS did something else than driving.

    Attributes:
        kind: "raised" an exception, gave an "invalid" answer, called for "exit", ran out of "memory", was in a "hang",
            or took its process down in a "crash".
        message: what exactly.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(f"the ADS failed ({kind}): {message}")
        self.kind = kind
        self.message = message


def rollout(env: gymnasium.Env[Any, Any], ads: Any, scenario: Scenario) -> Trace:
    """Run a scenario to its end.

    Args:
        env: takes `reset(options={"scenario": ...})` and ends an episode with `info["trace"]`.
        ads: see `behavexplor.ads.interface.ADS`; its decision log, if it keeps one, goes into the trace.
        scenario: the concrete scenario.

    Raises:
        ADSError: if the ADS fails, or what it answers is no action of the environment.
    """
    observation, info = env.reset(options={"scenario": scenario})
    state, start, log = None, np.ones(1, dtype=bool), []
    keeps_log = hasattr(ads, "log")
    done = False
    while not done:
        actions, state = _ask(ads, np.asarray(observation)[None], state, start, env.action_space)
        observation, _, terminated, truncated, info = env.step(actions[0])
        start = np.zeros(1, dtype=bool)
        done = terminated or truncated
        if keeps_log:
            log.append(ads.log(state))
    trace: Trace = info["trace"]
    return replace(trace, decisions=_stack(log))


def rollout_all(envs: VectorEnv[Any, Any, Any], ads: Any, scenarios: Iterable[Scenario]) -> Iterator[tuple[int, Trace]]:
    """Run scenarios to their ends, as many at a time as there are sub-environments; see `rollout`.

    Args:
        envs: with autoreset disabled; takes `reset(options={"scenarios": ..., "reset_mask": ...})`.
        ads: see `behavexplor.ads.interface.ADS`; asked for all sub-environments at once.
        scenarios: the concrete scenarios.

    Yields:
        The number of a scenario, counted from 0, and its trace, as they end.

    Raises:
        ADSError: if the ADS fails, or what it answers is no action of the environment.
    """
    waiting = enumerate(scenarios)
    slots = range(envs.num_envs)
    running = dict(zip(slots, waiting, strict=False))
    logs: list[list[Mapping[str, Any]]] = [[] for _ in slots]
    first = [running[slot][1] if slot in running else None for slot in slots]
    observation, _ = envs.reset(options={"scenarios": first})
    state, start = None, np.ones(len(slots), dtype=bool)
    while running:
        actions, state = _ask(ads, observation, state, start, envs.single_action_space)
        observation, _, terminated, truncated, infos = envs.step(actions)
        entries = ads.log(state) if hasattr(ads, "log") else {}
        for slot in running if entries else ():
            logs[slot].append({name: values[slot : slot + 1] for name, values in entries.items()})
        start = np.zeros(len(slots), dtype=bool)
        for slot in np.flatnonzero(terminated | truncated).tolist():
            if slot not in running:
                continue
            yield running.pop(slot)[0], replace(infos["trace"][slot], decisions=_stack(logs[slot]))
            if (following := next(waiting, None)) is not None:
                running[slot], logs[slot], start[slot] = following, [], True
        if start.any():
            fresh = [running[slot][1] if start[slot] else None for slot in slots]
            observation, _ = envs.reset(options={"scenarios": fresh, "reset_mask": start})


_asking: list[Any] = [SimpleNamespace(value=0)]  # whether an ADS is being asked right now


def share_asking(flag: Any) -> None:
    """Let others see whether this process is inside an ADS: `flag.value` is 1 there, and 0 elsewhere."""
    _asking[0] = flag


def _ask(
    ads: Any, observation: NDArray[Any], state: Any, start: NDArray[np.bool_], space: gymnasium.Space[Any]
) -> tuple[NDArray[Any], Any]:
    """The actions and the state that an ADS answers with, whatever it does."""
    _asking[0].value = 1
    try:
        return _checked(ads.predict(observation, state, start, deterministic=True), space, len(start))
    except _AnswerError as error:
        raise ADSError("invalid", str(error)) from error
    except MemoryError as error:
        raise ADSError("memory", "it ran out of memory") from error
    except SystemExit as error:
        raise ADSError("exit", f"it called sys.exit({error.code!r})") from error
    except Exception as error:
        raise ADSError("raised", f"{type(error).__name__}: {error}") from error
    finally:
        _asking[0].value = 0


class _AnswerError(ValueError):
    """What an ADS answered is no action."""


def _checked(answer: Any, space: gymnasium.Space[Any], count: int) -> tuple[NDArray[Any], Any]:
    """The actions and the state that an ADS has answered with.

    Raises:
        _AnswerError: saying what `predict` must return, if it returned something else.
    """
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise _AnswerError(f"predict must return a pair (actions, state), got {answer!r:.80}")
    actions = np.asarray(answer[0])
    expected = (count, *(space.shape or ()))
    if actions.shape != expected:
        raise _AnswerError(f"predict must return actions of shape {expected}, got {actions.shape}")
    if actions.dtype.kind not in "iuf" or not np.isfinite(actions).all():
        raise _AnswerError(f"predict must return finite numbers as actions, got {actions!r:.80}")
    if isinstance(space, gymnasium.spaces.Discrete):
        for action in actions:
            if not space.contains(action):
                raise _AnswerError(f"predict must return actions of {space}, got {action}")
    return actions, answer[1]


def _stack(log: list[Mapping[str, Any]]) -> dict[str, Any]:
    """The entries of all decisions of one episode by name, each of shape (D, ...)."""
    if not log:
        return {}
    return {name: np.stack([np.asarray(entry[name])[0] for entry in log]) for name in log[0]}
