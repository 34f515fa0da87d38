"""Episodes: an ADS drives concrete scenarios in an environment, one after the other or many in lock-step."""

from collections.abc import Iterable, Iterator
from itertools import islice
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from behavexplor.data.observations import Observation, arrays_of, mapped
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.errors import brief, place_of
from behavexplor.execution.drawn_actions import DrawnActions
from behavexplor.judge.specs import DIFFERS


class ADSError(Exception):
    """An ADS failed instead of returning an action.

    Attributes:
        kind: kind of the failure: "raised" (it raised an exception), "invalid" (its answer is not a valid action),
            "exit" (it called `sys.exit`), "memory" (it ran out of memory), "hang" (it did not answer in time),
            "crash" (its process died), or "differs" (highway-env did not confirm what the compiled engine found; see
            `behavexplor.execution.confirmation`).
        message: details of the failure.
        place: where the ADS raised an exception, see `behavexplor.errors.place_of`. It is no part of a record.
    """

    def __init__(self, kind: str, message: str, place: str = "") -> None:
        what = "highway-env did not confirm it" if kind == DIFFERS else f"the ADS failed ({kind})"
        super().__init__(f"{what}: {message}{place}")
        self.kind = kind
        self.message = message
        self.place = place


def rollout(env: gymnasium.Env[Any, Any], ads: Any, scenario: Scenario) -> Trace:
    """Run a scenario to its end.

    Args:
        env: environment that takes `reset(options={"scenario": ...})` and ends an episode with `info["trace"]`.
        ads: driving system, see `behavexplor.ads.interface.ADS`. If it keeps a decision log, the log is added to the
            trace.
        scenario: the concrete scenario.

    Returns:
        The trace of the episode.

    Raises:
        ADSError: if the ADS fails, or its answer is not a valid action of the environment.
    """
    observation, info = env.reset(options={"scenario": scenario})
    _begin(ads, 0, scenario)
    state, start, log = None, np.ones(1, dtype=bool), _Log(ads)
    done = False
    while not done:
        actions, state = _ask(ads, mapped(_batch_of_one, observation), state, start, env.action_space)
        observation, _, terminated, truncated, info = env.step(actions[0])
        log.add(state)
        start = np.zeros(1, dtype=bool)
        done = terminated or truncated
    trace: Trace = info["trace"]
    return log.completed(trace, 0)


def _begin(ads: Any, row: int, scenario: Scenario | None) -> None:
    """Begin the random numbers of an episode, if the ADS draws its actions."""
    if isinstance(ads, DrawnActions) and scenario is not None:
        ads.begin(row, scenario)


def _batch_of_one(array: Any) -> NDArray[Any]:
    return np.asarray(array)[None]


class LockStep:
    """Episodes of one ADS in lock-step, one in each sub-environment; see `rollout`.

    The ADS chooses the actions for all episodes in one call. In the row of a sub-environment without an episode, the
    observation is zero and the action is ignored.

    Args:
        envs: vector environment with autoreset disabled that takes
            `reset(options={"scenarios": ..., "reset_mask": ...})`.
        ads: driving system, see `behavexplor.ads.interface.ADS`.

    Attributes:
        free: number of sub-environments without an episode.
    """

    def __init__(self, envs: VectorEnv[Any, Any, Any], ads: Any) -> None:
        self.free = envs.num_envs
        self._envs = envs
        self._ads = ads
        self._scenarios: list[Scenario | None] = [None] * envs.num_envs
        self._keys: list[Any] = [None] * envs.num_envs
        self._running = np.zeros(envs.num_envs, dtype=bool)
        self._start = np.zeros(envs.num_envs, dtype=bool)
        self._begins = False  # True if an episode begins with the next step
        self._observation: Observation | None = None
        self._state: Any = None
        self._log = _Log(ads)

    @property
    def running(self) -> list[Any]:
        """Keys of the episodes that have not ended."""
        return [self._keys[slot] for slot in np.flatnonzero(self._running)]

    @property
    def is_running(self) -> bool:
        """True if an episode has not ended."""
        return self.free < len(self._running)

    def begin(self, key: Any, scenario: Scenario) -> None:
        """Add an episode, which begins with the next call of `step`. One of the sub-environments must be free.

        Args:
            key: key by which `step` identifies the episode.
            scenario: the concrete scenario.
        """
        slot = int(self._running.argmin())
        self._keys[slot], self._scenarios[slot] = key, scenario
        self._running[slot] = self._start[slot] = self._begins = True
        self.free -= 1

    def give_up(self) -> list[Any]:
        """End all episodes, and return their keys."""
        keys = self.running
        self._running[:] = self._start[:] = self._begins = False
        self.free = len(self._running)
        self._observation = self._state = None
        return keys

    def step(self) -> list[tuple[Any, Trace]]:
        """Advance all episodes by one decision.

        Returns:
            Key and trace of each episode that has ended.

        Raises:
            ADSError: if the ADS fails, or its answer is not a valid action of the environment. It is unknown which
                episode is to blame, and none of them can go on.
        """
        if self._begins or self._observation is None:
            self._observation = self._reset()
            if self._start[self._running].all():  # no other episode goes on: some drivers look at the state alone
                self._state = None
        observation, counts = mapped(np.asarray, self._observation), None
        if self.free:
            counts = self._running
            for array in arrays_of(observation):
                array[~counts] = 0
        actions, self._state = _ask(
            self._ads, observation, self._state, self._start, self._envs.single_action_space, counts
        )
        self._start, self._begins = np.zeros(len(self._running), dtype=bool), False
        self._observation, _, terminated, truncated, infos = self._envs.step(actions)
        self._log.add(self._state)
        ended = (self._running & (terminated | truncated)).nonzero()[0].tolist()
        if not ended:
            return []
        self._running[ended] = False
        self.free += len(ended)
        return [(self._keys[slot], self._log.completed(infos["trace"][slot], slot)) for slot in ended]

    def _reset(self) -> Any:
        """Begin the new episodes, and return the observations of all sub-environments."""
        if self._observation is None:  # the first reset needs a scenario even for a sub-environment without episode
            anything = self._scenarios[int(self._start.argmax())]
            scenarios = [scenario or anything for scenario in self._scenarios]
            observation, _ = self._envs.reset(options={"scenarios": scenarios})
        else:
            fresh = [scenario if start else None for scenario, start in zip(self._scenarios, self._start, strict=True)]
            observation, _ = self._envs.reset(options={"scenarios": fresh, "reset_mask": self._start})
        for slot in np.flatnonzero(self._start).tolist():
            _begin(self._ads, slot, self._scenarios[slot])
        self._log.begin(self._start, self._running)
        return observation


def rollout_all(envs: VectorEnv[Any, Any, Any], ads: Any, scenarios: Iterable[Scenario]) -> Iterator[tuple[int, Trace]]:
    """Run scenarios to their ends, as many at a time as there are sub-environments; see `LockStep`.

    Args:
        envs: see `LockStep`.
        ads: see `LockStep`.
        scenarios: the concrete scenarios.

    Yields:
        The index of a scenario, counted from 0, and its trace, in the order in which the episodes end.

    Raises:
        ADSError: if the ADS fails, or its answer is not a valid action of the environment.
    """
    yield from run_episodes(LockStep(envs, ads), scenarios)


def run_episodes(episodes: LockStep, scenarios: Iterable[Scenario]) -> Iterator[tuple[int, Trace]]:
    """Run scenarios to their ends in episodes that have no scenario yet; see `rollout_all`."""
    waiting = enumerate(scenarios)
    while True:
        for number, scenario in islice(waiting, episodes.free):
            episodes.begin(number, scenario)
        if not episodes.is_running:
            return
        yield from episodes.step()


class _Log:
    """Decision log of an ADS, with one entry per step for all sub-environments; empty for an ADS without `log`."""

    def __init__(self, ads: Any) -> None:
        self._ads = ads if callable(getattr(ads, "log", None)) else None  # else, it is something of the ADS's own
        self._entries: list[dict[str, NDArray[Any]]] = []
        self._dropped = 0  # number of deleted entries, all from before the running episodes began
        self._begins: dict[int, int] = {0: 0}

    def begin(self, slots: NDArray[np.bool_], running: NDArray[np.bool_]) -> None:
        """Begin episodes.

        Args:
            slots: sub-environments in which an episode begins.
            running: sub-environments with an episode, including the new ones.
        """
        now = self._dropped + len(self._entries)
        self._begins |= dict.fromkeys(np.flatnonzero(slots).tolist(), now)
        oldest = min(self._begins[slot] for slot in np.flatnonzero(running).tolist())
        del self._entries[: oldest - self._dropped]
        self._dropped = oldest

    def add(self, state: Any) -> None:
        """Add the log entries of the latest decisions.

        Raises:
            ADSError: if the ADS does not return its decisions.
        """
        if self._ads is None:
            return
        try:
            self._entries.append({name: np.array(values) for name, values in self._ads.log(state).items()})
        except Exception as error:
            raise ADSError("raised", f"log(state) must return arrays by name: {error}", place_of(error)) from error

    def completed(self, trace: Trace, slot: int) -> Trace:
        """Return a trace with the log entries of its episode, arrays of shape (D, ...)."""
        entries = self._entries[self._begins[slot] - self._dropped :]
        if not entries:
            return trace
        return trace.with_decisions({name: np.array([entry[name][slot] for entry in entries]) for name in entries[0]})


_asking: list[Any] = [SimpleNamespace(value=0)]  # 1 while the ADS is being called


def share_asking(flag: Any) -> None:
    """Set the flag that tells another process whether this process is calling the ADS.

    Args:
        flag: object whose `value` is set to 1 during a call of the ADS, and to 0 otherwise.
    """
    _asking[0] = flag


def _ask(
    ads: Any,
    observation: Observation,
    state: Any,
    start: NDArray[np.bool_],
    space: gymnasium.Space[Any],
    counts: NDArray[np.bool_] | None = None,
) -> tuple[NDArray[Any], Any]:
    """Call an ADS, and return its actions and state; every failure becomes an `ADSError`.

    Args:
        ads: the driving system.
        observation: observations, a row for each sub-environment.
        state: state returned by the previous call of the ADS.
        start: sub-environments in which an episode begins.
        space: action space of one sub-environment.
        counts: True for each row whose action is used, shape (B,); None if all actions are used.
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
    except Exception as error:
        raise ADSError("raised", f"{type(error).__name__}: {error}", place_of(error)) from error
    finally:
        _asking[0].value = 0


class _AnswerError(ValueError):
    """The answer of an ADS is not a valid action."""


def is_function(ads: Any) -> bool:
    """Return whether an ADS is a plain function; see `behavexplor.ads.function_driver`."""
    return getattr(ads, "is_function", False)


def _of_function(answer: Any, space: gymnasium.Space[Any]) -> str:
    """Return what a function must return, in place of an answer that is not valid."""
    return f"the function must return an action of {space}, got {brief(answer[0].tolist()[0])}"


def _checked(
    answer: Any, space: gymnasium.Space[Any], count: int, counts: NDArray[np.bool_] | None
) -> tuple[NDArray[Any], Any]:
    """Return the actions and the state of an answer. An action that is not used is replaced by one that is.

    Raises:
        _AnswerError: if the answer is invalid; the message says what `predict` must return.
    """
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise _AnswerError(f"predict must return a pair (actions, state), got {answer!r:.80}")
    actions = np.asarray(answer[0])
    expected = (count, *(space.shape or ()))
    if actions.shape != expected:
        raise _AnswerError(
            f"predict must return actions of shape {expected}, got {actions.shape}: a row for each observation"
        )
    if counts is not None:
        actions = np.where(counts.reshape(-1, *[1] * (actions.ndim - 1)), actions, actions[counts.argmax()])
    if actions.dtype.kind not in "iuf" or not np.isfinite(actions).all():
        raise _AnswerError(f"predict must return finite numbers as actions, got {actions!r:.80}")
    if isinstance(space, gymnasium.spaces.Discrete):
        valid = (actions >= space.start) & (actions < space.start + space.n) & (actions.dtype.kind != "f")
        if not valid.all():
            raise _AnswerError(f"predict must return actions of {space}, got {actions[valid.argmin()]}")
    return actions, answer[1]
