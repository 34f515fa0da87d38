"""Judges: processes that judge the traces of a long campaign with workers.

They never load a driver. What they say depends on a trace alone. So a campaign's records do not depend on whether a
judge or the campaign itself judged a trace, in which process, and together with which others. Only long campaigns have
them, because a process takes as long to start as to judge some hundred traces.
"""

import json
import math
import tempfile
from collections.abc import Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, Final, NamedTuple

import numpy as np

from behavexplor.behavior.features import ATTRIBUTES, known_states, state_matrix
from behavexplor.campaign.judgment import Judgment, judgment
from behavexplor.campaign.record import Result, encode_json, json_object, members_of
from behavexplor.data.drawn_logical import DrawnLogicalScenario
from behavexplor.data.scenario import LogicalScenario, draws
from behavexplor.data.trace import Trace
from behavexplor.envs.logical_scenarios import LOGICAL_SCENARIOS
from behavexplor.execution.confinement import confine
from behavexplor.execution.executor import ADSError
from behavexplor.execution.messages import packed, unpacked
from behavexplor.execution.pool import WorkerPool
from behavexplor.execution.service import Recipe, Service
from behavexplor.jit import keep_code_in
from behavexplor.judge.closest_approach import Nearness, known_nearness
from behavexplor.judge.specs import SPECS

JUDGE: Final = "judge"  # function of the service
WORKERS_OF_A_JUDGE: Final = 4  # a trace takes longer to drive than to judge
LEAST_EXECUTIONS: Final = 1500  # of a campaign for which it pays to start processes
MOST_IN_GROUP: Final = 64  # traces that are judged at a time
PATIENCE: Final = 600.0  # time limit of a group [s]
PASS_BY_FRAMES: Final = 31  # of the small trace, see `pass_by`
_END: Final = b"\0"  # of the texts about a trace
_PASS_BY_SPEED: Final = 10.0  # of its ego [m/s]


class JudgeService(Service):
    """Judges traces by the built-in specs, and draws their scenarios if workers have drawn them; see `judged`.

    Args:
        env: name of the environment with the logical scenario.
        logical: the logical scenario as JSON, if its name does not say all.
        nearness: whether to compute how near executions came to a failure, too.
    """

    def __init__(self, env: str = "", logical: str = "", *, nearness: bool) -> None:
        named: LogicalScenario | None = LOGICAL_SCENARIOS.get(env)
        self._logical = DrawnLogicalScenario.from_json(logical) if logical else named
        self._nearness = nearness
        self.functions = {JUDGE: self._judge}

    def _judge(self, request: bytes) -> bytes:
        parts = unpacked(request)  # two for each trace, see `Judges._send`
        pairs = zip(parts[::2], parts[1::2], strict=True)
        return packed([judged(data, drawn, self._logical, nearness=self._nearness) for data, drawn in pairs])

    def confine(self) -> None:
        """Give up the rights of this process, because traces come from processes of third-party code."""
        keep_code_in(Path(tempfile.mkdtemp()))  # a folder that can be written after `confine`, too
        confine()

    def begin(self) -> None:
        """Load the machine code by judging a small trace."""
        judged(pass_by().to_bytes())


class _Driven(NamedTuple):
    """A trace that waits for its judgment."""

    judging: "Future[Judgment]"
    data: bytes
    drawn: bytes  # the seed and the number by which its scenario was drawn; empty if the campaign knows the scenario


class Judges:
    """Processes that judge the traces of a campaign, which arrive one by one and are judged in groups.

    A group begins as soon as a process is free, with all traces that have arrived until then. There are no processes if
    `n_workers` is 0. With `nearness`, the traces know how near they came to a failure.
    """

    def __init__(self, n_workers: int, logical: LogicalScenario | None = None, *, nearness: bool = False) -> None:
        self._count = math.ceil(n_workers / WORKERS_OF_A_JUDGE)
        self._settings: dict[str, Any] = {"nearness": nearness}
        if logical:
            self._settings |= {"env": logical.name, "logical": logical.to_json()}
        self._knows_scenario = logical is not None and bool(logical.to_json() or logical.name in LOGICAL_SCENARIOS)
        self._pool: WorkerPool | None = None
        self._begun: Future[bytes] | None = None
        self._lock = Lock()  # guards the following fields, which the threads of two executors change
        self._waiting: list[_Driven] = []
        self._groups = 0  # under way

    def ready(self) -> bool:
        """Start the processes on the first call. Return whether they have begun, so that `follow` can be called."""
        if self._pool is None and self._count:
            # without `batched`, each of the first groups would start a process, though one process may be enough
            recipe = Recipe(f"{__name__}:{JudgeService.__name__}", self._settings, batched=JUDGE)
            self._pool = WorkerPool(self._count, recipe, PATIENCE, math.inf)
            self._begun = self._pool.submit(JUDGE, b"")  # of no traces: done as soon as a process has begun
        return self._begun is not None and self._begun.done() and self._begun.exception() is None

    def will_draw(self) -> bool:
        """Start the processes on the first call. Return whether `follow` can be called with `drawn`.

        It can while the processes are beginning, too: the traces wait for them.
        """
        is_ready = self.ready()
        is_beginning = self._begun is not None and not self._begun.done()
        return self._knows_scenario and (is_ready or is_beginning)

    def follow(self, driven: "Future[bytes]", drawn: bytes = b"") -> "Future[Judgment]":
        """Return the future judgment of a trace that is being driven.

        If the worker has drawn the scenario, `drawn` is what it was asked for, so that a judge draws it again. The
        exception is that of the driven trace, or an `ADSError` if what was driven is no trace.
        """
        judging: Future[Judgment] = Future()
        driven.add_done_callback(partial(self._take, judging, drawn))
        return judging

    def shutdown(self) -> None:
        """End the processes at once."""
        with self._lock:
            self._count = 0  # what is driven from now on is not judged
        if self._pool is not None:
            self._pool.shutdown(wait=False)

    def _take(self, judging: "Future[Judgment]", drawn: bytes, driven: "Future[bytes]") -> None:
        try:
            data = driven.result()
        except Exception as error:
            judging.set_exception(error)
            return
        with self._lock:
            self._waiting.append(_Driven(judging, data, drawn))
        self._send()

    def _send(self) -> None:
        with self._lock:
            if not self._waiting or self._groups >= self._count or self._pool is None:
                return
            group, self._waiting = self._waiting[:MOST_IN_GROUP], self._waiting[MOST_IN_GROUP:]
            self._groups += 1
            answer = self._pool.submit(JUDGE, packed([part for one in group for part in (one.data, one.drawn)]))
        answer.add_done_callback(partial(self._settle, group))

    def _settle(self, group: "Sequence[_Driven]", answer: "Future[bytes]") -> None:
        with self._lock:
            self._groups -= 1
        try:
            for one, found in zip(group, unpacked(answer.result()), strict=True):
                _resolve(one.judging, one.data, found)
        except Exception as error:
            for one in group:
                if not one.judging.done():
                    one.judging.set_exception(error)
        self._send()


def judged(data: bytes, drawn: bytes = b"", logical: LogicalScenario | None = None, *, nearness: bool = False) -> bytes:
    """Judge the bytes of a trace by the built-in specs.

    Return lines of text, a zero byte, and the ego's states as float32, see
    `behavexplor.behavior.features.state_matrix`. The lines are

    - the members of a `behavexplor.campaign.judgment.Judgment`, a line each; or only the member `error` if the bytes
      are no trace, which is the driver's failure. Then there are no states;
    - the scenario as JSON, if it was `drawn` by a seed and a number, else an empty line;
    - the nearness to a failure as JSON, if it is asked for, else an empty line.
    """
    try:
        found = judgment(data, None, SPECS)
    except ADSError as error:
        return "\n".join([*members_of({"error": error.message}), "", ""]).encode() + _END
    scenario = encode_json(logical.sample(draws(*json.loads(drawn))).to_dict()) if drawn and logical else ""
    near = json.dumps(Nearness.of(found.trace, found.result.verdict)) if nearness else ""
    return "\n".join([*found.members, scenario, near]).encode() + _END + state_matrix(found.trace).tobytes()


def _resolve(judging: "Future[Judgment]", data: bytes, found: bytes) -> None:
    """Give a future its judgment, or the driver's failure, as `judged` has told them."""
    head, _, states = found.partition(_END)
    *members, scenario, near = head.decode().split("\n")
    values = json.loads(json_object(members))
    if "error" in values:
        judging.set_exception(ADSError("crash", values["error"]))
        return
    matrix = np.frombuffer(states, dtype=np.float32).reshape(-1, len(ATTRIBUTES))
    computed = known_states("route", matrix) | (known_nearness(*json.loads(near)) if near else {})
    trace = Trace.of_packed(data, **computed)
    judging.set_result(Judgment(data, trace, Result.from_dict(values), members, scenario))


def pass_by() -> Trace:
    """Return a trace of an ego that passes a standing vehicle."""
    time = np.arange(PASS_BY_FRAMES) / 20
    position, velocity = np.zeros((2, PASS_BY_FRAMES, 2, 2))
    position[:, 0, 0] = _PASS_BY_SPEED * time
    velocity[:, 0, 0] = _PASS_BY_SPEED
    position[:, 1] = 8.0, 4.0
    return Trace(
        time=time,
        position=position,
        heading=np.zeros((PASS_BY_FRAMES, 2)),
        velocity=velocity,
        size=np.array([[5.0, 2.0], [5.0, 2.0]]),
        actions=np.zeros((0, 1)),
        action_frame=np.zeros(0, dtype=np.int64),
        route=np.array([[0.0, 0.0], [50.0, 0.0], [100.0, 0.0]]),
        destination=np.array([100.0, 0.0]),
        illegal_lines=np.array([[[0.0, -4.0], [100.0, -4.0]]]),
        end="timeout",
    )
