"""Episodes: an ADS drives concrete scenarios in an environment, one after the other or many in lock-step.

Before that, how an ADS is asked, and how it draws its actions; at the end, how its log of decisions is kept.
"""

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from types import SimpleNamespace
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.data.observations import Observation, arrays_of, mapped
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.errors import brief, described, place_of
from behavexplor.execution.executor import ADSError

STREAM: Final = 0x64_72_61_77  # separates the random numbers of drawn actions from others
COPIED: Final = 84  # exit code of a copy of a worker's process that an ADS has made

_asking: list[Any] = [SimpleNamespace(value=0)]  # 1 while the ADS is being called
_worker: list[int] = []  # the process in which it is called, if that is a worker


def share_asking(flag: Any) -> None:
    """Share a flag with another process: its `value` is 1 while this process, a worker, calls the ADS, else 0."""
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

    Args:
        ads: the ADS.
        observation: a row for each of B sub-environments.
        state: the state that the last call returned.
        start: whether an episode begins in each row, shape (B,).
        space: action space of a sub-environment.
        counts: whether the action of each row is used, shape (B,); None if all are.

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
            os._exit(COPIED)  # the ADS has forked: else, each decision would double the number of processes
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
    """Check the values of actions, whose shape is right."""
    if actions.dtype.kind not in "iuf" or not np.isfinite(actions).all():
        raise _AnswerError(f"predict must return finite numbers as actions, got {actions!r:.80}")
    if isinstance(space, gymnasium.spaces.Discrete):
        valid = (actions >= space.start) & (actions < space.start + space.n) & (actions.dtype.kind != "f")
        if not valid.all():
            raise _AnswerError(f"predict must return actions of {space}, got {actions[valid.argmin()]}")


class DrawnActions:
    """A stochastic policy that drives as in its training; see `behavexplor.ads.interface.StochasticADS`.

    Each episode has a stream of random numbers that depends on the scenario alone. So an episode can be repeated
    exactly, whichever episodes run beside it.
    """

    def __init__(self, policy: Any, count: int) -> None:
        self._policy = policy
        self._streams = [np.random.default_rng(STREAM) for _ in range(count)]

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the policy, such as its decision log."""
        return getattr(self._policy, name)

    def begin(self, row: int, scenario: Scenario) -> None:
        """Begin the stream of an episode, which is in this row of the next observation."""
        digest = hashlib.sha256(scenario.to_json().encode()).digest()
        self._streams[row] = np.random.default_rng([STREAM, int.from_bytes(digest[:16])])

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,  # noqa: ARG002 - the streams decide
    ) -> tuple[NDArray[Any], Any]:
        """Draw the actions of a batch of egos; see `behavexplor.ads.interface.ADS`."""
        noise = np.stack([stream.random(self._policy.noise) for stream in self._streams])
        answer: tuple[NDArray[Any], Any] = self._policy.draw(observation, state, episode_start, noise)
        return answer


def rollout(env: gymnasium.Env[Any, Any], ads: Any, scenario: Scenario) -> Trace:
    """Run a scenario to its end, and return the trace of the episode, with the log of decisions if the ADS keeps one.

    The environment takes `reset(options={"scenario": ...})` and ends an episode with `info["trace"]`.

    Raises:
        ADSError: if the ADS fails, or its answer is not a valid action of the environment.
    """
    observation, info = env.reset(options={"scenario": scenario})
    driver, log = EpisodeDriver(ads, env.action_space, scenario), DecisionRecorder(ads, 1)
    done = False
    while not done:
        observation, _, terminated, truncated, info = env.step(driver(observation))
        log.add(driver.state)
        done = terminated or truncated
    trace: Trace = info["trace"]
    return log.completed(trace, 0)


class EpisodeDriver:
    """A driving system in one episode: a function from an observation of the environment to an action.

    A stochastic policy draws its actions by the scenario of the episode.
    """

    def __init__(self, ads: Any, space: gymnasium.Space[Any], scenario: Scenario) -> None:
        self._ads, self._space = ads, space
        self._start = np.ones(1, dtype=bool)
        self.state: Any = None  # state that `predict` returned last
        _begin(ads, 0, scenario)

    def __call__(self, observation: Observation) -> Any:
        """Return the action after an observation; `ADSError` if the ADS gives none that is valid."""
        batch = mapped(lambda array: np.asarray(array)[None], observation)
        actions, self.state = ask(self._ads, batch, self.state, self._start, self._space)
        self._start = np.zeros(1, dtype=bool)
        return actions[0]


def _begin(ads: Any, row: int, scenario: Scenario | None) -> None:
    """Begin the random numbers of an episode, if the ADS draws its actions."""
    if isinstance(ads, DrawnActions) and scenario is not None:
        ads.begin(row, scenario)


class LockStep:
    """Episodes of one ADS in lock-step, one in each sub-environment; see `rollout`.

    The ADS chooses the actions for all episodes in one call. In the row of a sub-environment without an episode, the
    observation is zero and the action is ignored. The vector environment has autoreset disabled, and takes
    `reset(options={"scenarios": ..., "reset_mask": ...})`. With `logs`, traces have the driving system's decision log.
    """

    def __init__(self, envs: VectorEnv[Any, Any, Any], ads: Any, *, logs: bool = True) -> None:
        self.free = envs.num_envs  # number of sub-environments without an episode
        self._envs = envs
        self._ads = ads
        self._scenarios: list[Scenario | None] = [None] * envs.num_envs
        self._keys: list[Any] = [None] * envs.num_envs
        self._running = np.zeros(envs.num_envs, dtype=bool)
        self._start = np.zeros(envs.num_envs, dtype=bool)
        self._begins = False  # True if an episode begins with the next step
        self._observation: Observation | None = None
        self._state: Any = None
        self._log = DecisionRecorder(ads if logs else None, envs.num_envs)

    @property
    def running(self) -> list[Any]:
        """Keys of the episodes that have not ended."""
        return [self._keys[slot] for slot in np.flatnonzero(self._running)]

    @property
    def is_running(self) -> bool:
        """True if an episode has not ended."""
        return self.free < len(self._running)

    def begin(self, key: Any, scenario: Scenario) -> None:
        """Add an episode, which begins with the next call of `step`. There, it is identified by the key.

        One of the sub-environments must be free.
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
        """Advance all episodes by one decision, and return key and trace of each that has ended.

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
        actions, self._state = ask(
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

    Yield the index of a scenario, counted from 0, and its trace, in the order in which the episodes end.

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


_LEAST_ROOM: Final = 64  # rows of a log of decisions


class DecisionRecorder:
    """Records what an ADS logs of its decisions in B episodes in lock-step: nothing without a method `log`."""

    def __init__(self, ads: Any, count: int) -> None:
        self._ads = ads if callable(getattr(ads, "log", None)) else None  # else, it is something of the ADS's own
        self._columns: dict[str, Floats] | None = None  # by name, shape (rows, B, ...), a row for each step
        self._rows = 0  # number of rows in use
        self._room = 0  # number of rows for which there is room
        self._begins = np.zeros(count, dtype=np.int64)  # first row of each episode
        self._oldest = 0  # first row of the running episode that began first

    def begin(self, slots: NDArray[np.bool_], running: NDArray[np.bool_]) -> None:
        """Begin the episodes for which `slots`, shape (B,), is True; `running` is so for all that run, these too."""
        if slots[running].all():  # no older episode goes on, and these may have other names and shapes
            self._columns, self._rows, self._room = None, 0, 0
        self._begins[slots] = self._rows
        self._oldest = int(self._begins[running].min())

    def add(self, state: Any) -> None:
        """Add the latest decisions, by the state that `predict` returned.

        Raises:
            ADSError: if the ADS raises an exception, or returns something else than
                `behavexplor.ads.interface.DecisionLog` says.
        """
        if self._ads is None:
            return
        try:
            latest = {name: np.asarray(values) for name, values in self._ads.log(state).items()}
        except Exception as error:
            raise ADSError("raised", f"log(state) must return arrays by name: {error}", place_of(error)) from error
        self._append(latest)

    def completed(self, trace: Trace, slot: int) -> Trace:
        """Return `trace`, that of the ended episode in `slot`, with its decisions: arrays of shape (D, ...).

        Raises:
            InputError: if a logged number is not finite.
        """
        if not self._columns:
            return trace
        first, end = self._begins[slot], self._rows
        return trace.with_decisions({name: column[first:end, slot] for name, column in self._columns.items()})

    def _append(self, latest: Mapping[str, NDArray[Any]]) -> None:
        if self._columns is None:
            count = len(self._begins)
            self._columns = {name: np.empty((0, count, *values.shape[1:])) for name, values in latest.items()}
        if latest.keys() != self._columns.keys():
            names = f"first {list(self._columns)}, now {list(latest)}"
            raise ADSError("raised", f"log(state) must return the same names at every decision: {names}")
        if self._rows == self._room:
            self._columns = self._with_room(self._columns)
        for name, values in latest.items():
            row = self._columns[name][self._rows]
            if values.shape != row.shape or values.dtype.kind not in "biuf":
                wanted = f"numbers of shape {row.shape} as {name!r}"
                raise ADSError("raised", f"log(state) must return {wanted}, got {values.dtype} of shape {values.shape}")
            row[:] = values
        self._rows += 1

    def _with_room(self, columns: Mapping[str, Floats]) -> dict[str, Floats]:
        """Return columns without the rows from before the running episodes, and with room for more."""
        kept = slice(self._oldest, self._rows)
        self._begins -= self._oldest
        self._rows -= self._oldest
        self._oldest = 0
        self._room = max(_LEAST_ROOM, 2 * self._rows)
        roomy = {name: np.empty((self._room, *column.shape[1:])) for name, column in columns.items()}
        for name, column in columns.items():
            roomy[name][: self._rows] = column[kept]
        return roomy
