"""Evaluator: the service that executes scenarios of one target in this process."""

import json
import logging
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from behavexplor.ads.interface import ADS
from behavexplor.ads.loading import is_shipped
from behavexplor.data.scenario import Scenario, draws, parse_scenario
from behavexplor.data.target import OF_EPISODES, CheckedTarget, Target
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError, sentence
from behavexplor.execution.checked_imports import import_checked
from behavexplor.execution.confinement import confine
from behavexplor.execution.executor import LOCK_STEP, ADSError
from behavexplor.execution.fingerprint import FINGERPRINT, fingerprint
from behavexplor.execution.forkserver import preloaded_modules
from behavexplor.execution.preflight import preflight_warnings
from behavexplor.execution.rollout import LockStep
from behavexplor.execution.service import Recipe, Service
from behavexplor.execution.simulation import Simulation, compile_kernels
from behavexplor.jit import keep_code_in

EXECUTE: Final = "execute"  # functions of the service, beside `FINGERPRINT`
ORIGINAL: Final = "original"
PREFLIGHT: Final = "preflight"
LOGICAL: Final = "logical"
ROAD: Final = "road"
DRAWS: Final = "draws"

_JIT_LOGGER: Final = "behavexplor.jit"  # logger that tells that the user has to wait, which is no warning about an ADS


class Evaluator(Service):
    """Executes scenarios, checks the ADS before a campaign, and reports the fingerprint that results depend on.

    `lock_step` is the greatest number of episodes that run in lock-step. The other arguments are the fields of a
    `behavexplor.data.target.CheckedTarget`.
    """

    def __init__(self, lock_step: int = LOCK_STEP, **target: Any) -> None:
        self.target = CheckedTarget(**target)
        # whether this process gives up rights: for third-party code, unless the target is `unconfined`
        self.is_confined = needs_confinement(self.target)
        self._lock_step = lock_step
        self.driver: ADS | None = None  # drives in place of the target's ADS; None if that drives
        self.simulation: Simulation  # from `begin` on
        self.functions: Mapping[str, Callable[[bytes], bytes]] = {
            EXECUTE: self.execute,
            ORIGINAL: self.original,
            PREFLIGHT: self.preflight,
            LOGICAL: self.logical,
            ROAD: self.road,
            DRAWS: self.can_draw,
            FINGERPRINT: fingerprint,
        }
        self.batch: ScenarioBatch | None = None  # executes scenarios in lock-step; None if ADS or environment cannot
        self._unprevented: tuple[str, ...] = ()  # what this system cannot prevent the ADS from doing
        self._notices: list[str] = []

    def prepare(self) -> None:
        """Compile the kernels that confined workers need, because those workers cannot write the compilation cache."""
        if self.is_confined:
            compile_kernels(self.target.env)

    def confine(self) -> None:
        """Confine this process if it has to be; see `behavexplor.execution.confinement`."""
        if self.is_confined:
            keep_code_in(Path(tempfile.mkdtemp()))  # this process will not be able to write into the usual folder
            self._unprevented = confine()

    def begin(self) -> None:
        """Load the ADS and create its environment.

        Raises:
            InputError: see `behavexplor.execution.simulation.Simulation`.
        """
        try:
            with collected_notices() as self._notices:
                import_checked(self.target.modules)
                self.simulation = simulation_of(self.target, self.driver)
        except InputError as error:
            raise InputError(_explained(str(error))) from None
        episodes = self.simulation.lock_step(self._lock_step)
        if episodes is not None:
            self.batch = ScenarioBatch(self.simulation, episodes, self.answer)

    def execute(self, scenario: bytes) -> bytes:
        """Execute a scenario, given as JSON or as the seed and the number of a uniform draw, and return its `answer`.

        Raises:
            ADSError: if the ADS fails.
        """
        return self.answer(self.simulation.run_compiled(_scenario(scenario, self.simulation)))

    def original(self, scenario: bytes) -> bytes:
        """Execute a scenario, given as JSON, in highway-env itself, and return its trace as bytes.

        The environment must be one of highway-env.

        Raises:
            ADSError: if the ADS fails.
        """
        return self.simulation.run(_scenario(scenario, self.simulation)).to_bytes()

    def answer(self, trace: Trace) -> bytes:
        """Return what is told about an executed scenario: its trace, see `behavexplor.data.trace.Trace.to_bytes`."""
        return trace.to_bytes()

    def logical(self, _: bytes) -> bytes:
        """Return a highway-env environment's logical scenario, which depends on the ADS, as JSON; b"" for others."""
        return self.simulation.logical.to_json().encode()

    def road(self, _: bytes) -> bytes:
        """Return the shape of a highway-env environment's road as JSON; nothing for an environment of another kind."""
        road: Any = getattr(self.simulation.env, "road_shape", None)
        return road().to_json().encode() if road is not None else b""

    def can_draw(self, _: bytes) -> bytes:
        """Return whether the ADS could draw its actions: one byte if so, none otherwise."""
        return b"1" if getattr(self.simulation.ads, "noise", 0) else b""

    def preflight(self, _: bytes) -> bytes:
        """Return warnings about the ADS as a JSON list of sentences.

        They are those of `behavexplor.execution.preflight`, those that were logged while the ADS was loaded, and what
        this system cannot prevent the ADS from doing.
        """
        unprevented = [f"This system cannot confine the ADS: it can {right}" for right in self._unprevented]
        found = [*self._notices, *map(_explained, preflight_warnings(self.simulation)), *unprevented]
        return json.dumps(list(dict.fromkeys(found))).encode()


class ScenarioBatch:
    """Executes many scenarios in lock-step; see `behavexplor.execution.service.Batch`.

    Its capacity is the number of `episodes` that could begin when it was made. `answer` makes a trace into the result
    of its request.
    """

    def __init__(self, simulation: Simulation, episodes: LockStep, answer: Callable[[Trace], bytes]) -> None:
        self._simulation = simulation
        self._episodes = episodes
        self._answer = answer
        self.capacity = episodes.free

    def begin(self, key: int, request: bytes) -> None:
        """Take one more scenario, given as in `Evaluator.execute`.

        Raises:
            InputError: if the scenario does not fit this environment.
        """
        scenario = _scenario(request, self._simulation)
        self._simulation.logical.check(scenario)
        self._episodes.begin(key, scenario)

    def advance(self) -> list[tuple[int, bytes | Exception | None]]:
        """Advance all episodes by one decision.

        If the ADS fails, all running scenarios must be executed alone, since it is unknown which of them is to blame.
        That is known of an ADS that drives one episode at a time: its failure is an outcome. If the environment does
        not begin an episode, they are executed alone, too.
        """
        try:
            ended = self._episodes.step()
        except (ADSError, InputError) as error:
            keys = self._episodes.give_up()
            if self.capacity == 1 and isinstance(error, ADSError):  # not the last of many, which depends on the others
                return [(key, error) for key in keys]
            return [(key, None) for key in keys]
        return [(key, self._answer(trace)) for key, trace in ended]


def simulation_of(target: Target, driver: ADS | None = None, render_mode: str | None = None) -> Simulation:
    """Return the simulation of a target. If there is a `driver`, it drives in place of the one that the target names.

    `render_mode` is as in gymnasium.

    Raises:
        InputError: see `behavexplor.execution.simulation.Simulation`.
    """
    settings = {name: getattr(target, name) for name in OF_EPISODES}  # env_config, traffic, stochastic, activation
    return Simulation(target.env, driver or target.ads, target.trust, render_mode=render_mode, **settings)


def evaluator_recipe(target: Target, at_a_time: int = LOCK_STEP) -> Recipe:
    """Return the recipe by which worker processes make the evaluator of a target.

    A process executes `at_a_time` scenarios at a time. A driver also decides for the episodes in lock-step that are not
    there, so there are no more of them than necessary.
    """
    return recipe_for(Evaluator, target, lock_step=min(at_a_time, LOCK_STEP))


def recipe_for(service: type[Evaluator], target: Target, **settings: Any) -> Recipe:
    """Return the recipe by which worker processes make an evaluator, or a service derived from it, for a target.

    The settings are further keyword arguments of the class, as JSON values.
    """
    return Recipe(
        f"{service.__module__}:{service.__qualname__}",
        {**target.to_dict(), **settings},
        batched=EXECUTE,
        preload=(service.__module__, *preloaded_modules(target.env, target.ads)),
    )


def needs_confinement(target: Target) -> bool:
    """Return whether the ADS is third-party code that may neither write files nor use the network."""
    return not (target.unconfined or is_shipped(target.ads))


def _explained(message: str) -> str:
    """Return an error message, with a hint if confinement is its likely cause."""
    if "PermissionError" not in message:
        return message
    return f"{message}: without --unconfined, an ADS may neither write files nor use the network"


def _scenario(data: bytes, simulation: Simulation) -> Scenario:
    """Return the scenario of a request: JSON of the scenario, or of the [seed, number] of a uniform draw."""
    if data.startswith(b"["):
        return simulation.logical.sample(draws(*json.loads(data)))
    return parse_scenario(data.decode())


@contextmanager
def collected_notices() -> Iterator[list[str]]:
    """Collect what is logged at level WARNING or above, and Python's warnings, instead of showing it.

    Yield a list to which each notice is added as a printable line, those of Python at the end of the context.
    """
    notices: list[str] = []
    handler = _Collector(notices)
    root = logging.getLogger()
    root.addHandler(handler)
    try:
        with warnings.catch_warnings(record=True) as issued:
            yield notices
    finally:
        root.removeHandler(handler)
    notices += [sentence(str(warning.message)) for warning in issued]


class _Collector(logging.Handler):
    def __init__(self, notices: list[str]) -> None:
        super().__init__(logging.WARNING)
        self._notices = notices
        self.addFilter(lambda record: record.name != _JIT_LOGGER)

    def emit(self, record: logging.LogRecord) -> None:
        self._notices.append(sentence(record.getMessage()))
