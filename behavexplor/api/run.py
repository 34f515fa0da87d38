"""A run as an object, with methods for all that can be done with it; and an execution's environment and replay."""

import base64
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cached_property
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import gymnasium
from PIL import Image

from behavexplor.ads.in_memory import GivenDriver, given_driver
from behavexplor.api.conducting import conduct, worker_count
from behavexplor.api.dataframes import frame_of
from behavexplor.api.observers import Observer
from behavexplor.campaign.config import CampaignConfig, stored_config
from behavexplor.campaign.judgment import Repetition, repeat_execution
from behavexplor.campaign.provenance import ALL, DRIVING, JUDGED, Consent
from behavexplor.campaign.record import Record
from behavexplor.campaign.run_summary import RunSummary, by_class, summarize
from behavexplor.campaign.same_driver import accepted_run
from behavexplor.campaign.store import Execution, Store
from behavexplor.data.durable import new_file, writing
from behavexplor.data.road_shape import RoadShape
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError
from behavexplor.execution.evaluator import simulation_of
from behavexplor.execution.rollout import EpisodeDriver
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import fewest_workers, start_executor
from behavexplor.judge.robustness import load_specs
from behavexplor.judge.specs import judge
from behavexplor.report.drawing import decisive_frame, draw, footage_of, save_animation
from behavexplor.report.reading import read_run
from behavexplor.report.road_shapes import known_road
from behavexplor.report.run_page import PAGE, page, written
from behavexplor.triage.findings import Minimized, Triage
from behavexplor.triage.minimization import RunMinimization
from behavexplor.triage.run_triage import RunTriage

if TYPE_CHECKING:
    import pandas as pd

_SUFFIXES: Final = (".gif", ".png")  # of files that a replay is saved as


class Run:
    """One campaign in its run folder, finished or not. What it offers is read from the folder when it is asked for.

    Args:
        folder: the run folder.
        driver: the driver of the campaign, as `behavexplor.find_failures` takes it. It is needed only to execute
            something, and only if the driver was an object in memory.
        trust: digests ("sha256:...") of a folder that was made elsewhere and whose code may be run, and of policy files
            that may run code while they are loaded.
        unconfined: whether a third-party driver may write files and use the network.

    Attributes:
        folder: the run folder.

    Raises:
        InputError: if the folder is not a run folder, or the driver is not that of the run.
    """

    def __init__(
        self, folder: str | Path, driver: Any = None, *, trust: str | Sequence[str] = (), unconfined: bool = False
    ) -> None:
        self.folder = Path(folder)
        self._consent = Consent((trust,) if isinstance(trust, str) else tuple(trust), unconfined)
        self._given = GivenDriver(self.config.ads) if driver is None else self._checked(driver)

    @cached_property
    def config(self) -> CampaignConfig:
        """The configuration of the campaign, as the folder says it. What is executed goes through `_accepted`."""
        return stored_config(self.folder).unverified

    def _accepted(self, runs: Collection[str] = DRIVING, *, goes_on: bool = False) -> CampaignConfig:
        """Return the configuration. Its code under the keys `runs` may be run; see `accepted_run`."""
        given = self._given
        names = (given.name,) if given.is_named or given.driver is not None else ()  # code that the user has given
        consent = replace(self._consent, names=names)
        return accepted_run(self.folder, consent, runs, goes_on=goes_on)

    @property
    def summary(self) -> RunSummary:
        """The figures of the run: executions, failures, classes, and so on."""
        return summarize(self.folder)

    @property
    def records(self) -> tuple[Record, ...]:
        """The records of all executions, in order."""
        with closing(Store.read(self.folder)) as store:
            return tuple(store.records())

    @property
    def failures(self) -> "pd.DataFrame":
        """The failed executions as a DataFrame; see `to_pandas`."""
        return frame_of(record for record in self.records if record.failed)

    def to_pandas(self) -> "pd.DataFrame":
        """Return all executions as a DataFrame; see `behavexplor.api.dataframes.frame_of` for its columns.

        Raises:
            InputError: if pandas is not installed.
        """
        return frame_of(self.records)

    @property
    def classes(self) -> dict[str, list[int]]:
        """Numbers of the failures of each class, the most frequent class first."""
        return {kind: [record.id for record in group] for kind, group in by_class(self.records).items()}

    def trace(self, number: int) -> Trace:
        """Return the trace of an execution.

        Raises:
            InputError: if there is no execution of that number.
        """
        return self._execution(number).load_trace()

    @property
    def traces(self) -> Iterator[Trace]:
        """The traces of all executions, in order, read one by one."""
        with closing(Store.read(self.folder)) as store:
            for execution in store.executions():
                yield execution.load_trace()

    def scenario(self, number: int) -> Scenario:
        """Return the scenario of an execution.

        Raises:
            InputError: if there is no execution of that number.
        """
        return self._execution(number).scenario

    def replay(self, number: int) -> "Replay":
        """Return the replay of an execution, which a notebook shows as an animation.

        Raises:
            InputError: if there is no execution of that number.
        """
        return Replay(self._execution(number), known_road(self.config.env, self.folder))

    def env(self, number: int, render_mode: str | None = None) -> "Episode":
        """Return the environment of an execution, for a loop of your own: its `reset` begins the scenario.

            env = run.env(17)
            observation, info = env.reset()
            while "trace" not in info:
                observation, reward, terminated, truncated, info = env.step(env.driver(observation))
            print(run.violated(info["trace"]))

        `env.driver` is the driver of the run, loaded in this process, where nothing confines it. Any other policy with
        the same observations can take its place.

        Args:
            number: number of the execution.
            render_mode: what `render` returns or shows, such as "human" or "rgb_array".

        Raises:
            InputError: if there is no execution of that number, or the driver cannot be loaded.
        """
        simulation = simulation_of(self._accepted().target, self._given.driver, render_mode)
        return Episode(simulation, self.scenario(number))

    def violated(self, trace: Trace) -> tuple[str, ...]:
        """Return the names of the run's requirements that a trace violates, the most severe one first.

        Raises:
            InputError: if a requirement of the run cannot be loaded.
        """
        return judge(trace, load_specs(self._accepted(JUDGED).specs)).violated

    def repeat(self, number: int) -> Repetition:
        """Execute a scenario of the run again, and tell whether the trace is the same.

        Raises:
            InputError: if there is no execution of that number, or the driver cannot be loaded.
        """
        target = self._accepted().target
        with start_executor(target, fewest_workers(target), driver=self._given.driver) as executor:
            return repeat_execution(executor, self._execution(number))

    def triage(self, *, workers: int | None = None, afresh: bool = False) -> Triage:
        """Find out whose fault the failures were, and what caused them. The findings are kept in the run folder.

        Args:
            workers: number of worker processes; by default none, if the driver need not be confined.
            afresh: whether to examine known failures again.

        Raises:
            InputError: if the driver cannot be loaded.
        """
        config = self._accepted(JUDGED)
        count = worker_count(self._given, config.target, workers)
        return RunTriage(self.folder, config, count, afresh=afresh, driver=self._given.driver).examine(lambda _: None)

    def minimize(self, numbers: Iterable[int] | None = None, *, workers: int | None = None) -> list[Minimized]:
        """Find the simplest scenarios in which failures still happen. Minimized failures are not minimized again.

        Args:
            numbers: numbers of failed executions; by default the first failure of each class.
            workers: number of worker processes; by default none, if the driver need not be confined.

        Returns:
            The minimized failures, in the order of their numbers.

        Raises:
            InputError: if an execution did not fail, or the run folder cannot be written.
        """
        given = None if numbers is None else [int(number) for number in numbers]
        if given == []:  # such as the index of a table without rows
            return []
        config = self._accepted(JUDGED)
        count = worker_count(self._given, config.target, workers)
        work = RunMinimization(self.folder, config, count, given or (), driver=self._given.driver)
        return work.minimize(lambda _: None)

    def report(self, path: str | Path | None = None, *, replays: int = 100) -> Path:
        """Write the findings as one self-contained HTML page.

        Args:
            path: the file to write; by default report.html in the run folder.
            replays: greatest number of replays on the page.

        Returns:
            The path of the page.

        Raises:
            InputError: if the run has no executions yet, the number of replays is out of range, or the page cannot be
                written.
        """
        text = page([read_run(self.folder)], replays)
        return written(self.folder / PAGE if path is None else Path(path), text)

    def resume(
        self,
        driver: Any = None,
        *,
        budget: int | str | None = None,
        workers: int | None = None,
        stop_after: int | None = None,
        progress: bool | Observer | None = None,
    ) -> Self:
        """Continue the campaign until its budget is used up.

        Args:
            driver: the driver, if it was an object in memory and this run was opened without it.
            budget: a larger budget; by default that of the run.
            workers: see `behavexplor.find_failures`.
            stop_after: see `behavexplor.find_failures`.
            progress: see `behavexplor.find_failures`.

        Returns:
            This run.

        Raises:
            InputError: if the driver cannot be loaded, or is not that of the run.
            behavexplor.Interrupted: after Ctrl-C.
        """
        self._given = self._given if driver is None else self._checked(driver)
        config = self._accepted(ALL, goes_on=True)
        if budget is not None:
            config = replace(config, budget=str(budget))
        choices: dict[str, Any] = {"workers": workers, "stop_after": stop_after, "progress": progress}
        try:
            conduct(config, self.folder, self._given, resume=True, **choices)
        finally:
            self.__dict__.pop("config", None)  # it may have another budget now, also after Ctrl-C
        return self

    def _checked(self, driver: Any) -> GivenDriver:
        """Return a given driver, and check that it has the name of this run's driver."""
        given = given_driver(driver)
        if given.name != self.config.ads:
            raise InputError(f"{self.folder} is a run of {self.config.ads!r}, not of {given.name!r}")
        return given

    def _execution(self, number: int) -> Execution:
        with closing(Store.read(self.folder)) as store:
            return store.execution(int(number))  # numbers from a DataFrame are numpy's

    def __len__(self) -> int:
        with closing(Store.read(self.folder)) as store:
            return len(store)

    def __repr__(self) -> str:
        found = self.summary
        return f"<Run {self.folder}: {found.executions} executions, {found.words}>"

    def _repr_html_(self) -> str:
        found = self.summary
        head = f"{found.ads} in {found.env}, {found.method}, seed {found.seed}"
        rows = "".join(
            f"<tr><td>{escape(one.words)}</td><td>{one.count}</td><td>{one.first}</td></tr>" for one in found.classes
        )
        return (
            f"<p><b>{escape(head)}</b>: {found.executions} executions, "
            f"{escape(found.words)}<br><code>{escape(str(self.folder))}</code></p>"
            f"<table><tr><th>class of failures</th><th>count</th><th>first</th></tr>{rows}</table>"
        )


def open_run(
    folder: str | Path, driver: Any = None, *, trust: str | Sequence[str] = (), unconfined: bool = False
) -> Run:
    """Open a run folder that the command or the Python interface has written.

    Args:
        folder: the run folder.
        driver: the driver, if it was an object in memory; see `Run`.
        trust: digests of what may run code although it was made elsewhere; see `Run`.
        unconfined: whether a third-party driver may write files and use the network.

    Raises:
        InputError: if the folder is not a run folder, or the driver is not that of the run.
    """
    return Run(folder, driver, trust=trust, unconfined=unconfined)


class Episode(gymnasium.Wrapper[Any, Any, Any, Any]):
    """The environment in which a scenario was executed, as the driver saw it. Each `reset` begins the scenario.

    Rendering and `unwrapped` are those of the environment. At the end of the episode, `info["trace"]` is its trace.
    """

    def __init__(self, simulation: Simulation, scenario: Scenario) -> None:
        super().__init__(simulation.env)
        self._scenario, self._simulation = scenario, simulation
        self._driver: EpisodeDriver | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the scenario, or the one in `options`."""
        scenario = (options or {}).get("scenario", self._scenario)
        self._driver = EpisodeDriver(self._simulation.driver(1), self.action_space, scenario)
        return self.env.reset(seed=seed, options={**(options or {}), "scenario": scenario})

    def driver(self, observation: Any) -> Any:
        """Return the action of the run's driver after an observation of this episode.

        Raises:
            InputError: if no episode has begun.
            behavexplor.execution.executor.ADSError: if the driver fails.
        """
        if self._driver is None:
            raise InputError("The episode has not begun: call reset first")
        return self._driver(observation)


class Replay:
    """The replay of one execution, which a notebook shows as an animation.

    Args:
        execution: the execution.
        shape: the road on which it was driven.

    Attributes:
        number: number of the execution.
        trace: its trace.
        caption: what happened, such as "failed (collision and destination), ended by a collision".
    """

    def __init__(self, execution: Execution, shape: RoadShape) -> None:
        self.number = execution.id
        self._footage = footage_of(execution, shape)
        self.trace: Trace = self._footage.trace
        self.caption = self._footage.caption

    def __repr__(self) -> str:
        return f"<Replay of execution {self.number}: {self.caption}>"

    @cached_property
    def gif(self) -> bytes:
        """The animation as a GIF file."""
        file = BytesIO()
        save_animation(file, self._footage)
        return file.getvalue()

    @property
    def picture(self) -> Image.Image:
        """The decisive frame: the first touch of a line, the last frame of other failures, or the nearest pass."""
        return draw(self._footage, decisive_frame(self.trace, self._footage.violated))

    def save(self, path: str | Path) -> Path:
        """Write the animation (.gif) or the decisive frame (.png) to a file, and return its path.

        Raises:
            InputError: if the file has another suffix, or cannot be written.
        """
        target = Path(path)
        if target.suffix not in _SUFFIXES:
            raise InputError(f"A replay is saved as {' or '.join(_SUFFIXES)}, not as {target.name!r}")
        with writing(f"The replay {target}"), new_file(target) as file:
            if target.suffix == ".gif":
                file.write(self.gif)
            else:
                self.picture.save(file, "PNG")
        return target

    def _repr_html_(self) -> str:
        data = base64.b64encode(self.gif).decode()
        title = escape(f"Execution {self.number} {self.caption}")
        return (
            f'<figure><img alt="{title}" src="data:image/gif;base64,{data}"><figcaption>{title}</figcaption></figure>'
        )
