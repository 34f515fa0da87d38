"""Comparison of two drivers in the same scenarios, from Python."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium

from behavexplor.ads.in_memory import given_driver
from behavexplor.api.campaigns import Requirement, config_of
from behavexplor.api.conducting import Interrupted, conduct, worker_count
from behavexplor.api.dataframes import frame_of_pairs
from behavexplor.api.observers import Observer
from behavexplor.api.run import Run
from behavexplor.campaign.config import CampaignConfig, stamped_folder
from behavexplor.errors import InputError
from behavexplor.repair import pair_campaigns
from behavexplor.repair.pair_campaigns import FIRST, PAGE, SECOND, SETTINGS, compared, second_config
from behavexplor.repair.pairs import AT_FAULT, COLUMNS, LEGEND, MarginDecision, Pairs, rows
from behavexplor.report.reading import read_run
from behavexplor.report.run_page import page, written

if TYPE_CHECKING:
    import pandas as pd


class Comparison:
    """Two drivers in the same scenarios. Everything is read from the folder when it is asked for.

    Args:
        folder: folder of the comparison, which `behavexplor.compare` or the command has written.
        first: the first driver, if it was an object in memory; see `behavexplor.Run`.
        second: the second driver, if it was an object in memory.

    Attributes:
        folder: the folder.
        first: the run of the first driver.
        second: the run of the second driver.

    Raises:
        InputError: if the folder is not that of a comparison, or a given driver is not that of its run.
    """

    def __init__(self, folder: str | Path, first: Any = None, second: Any = None) -> None:
        self.folder = Path(folder)
        self.first, self.second = Run(self.folder / FIRST, first), Run(self.folder / SECOND, second)

    @property
    def pairs(self) -> tuple[Pairs, ...]:
        """The paired statistics of each outcome: any failure, failures at fault, and violations of each requirement."""
        return tuple(compared(self.folder))

    def decision(self, margin: float) -> MarginDecision:
        """Return the decision whether the second driver is no worse than the first one by a margin, such as 0.01.

        Raises:
            InputError: if the margin is not between 0 and 1.
        """
        pair_campaigns.check_margin(margin)
        return MarginDecision.of(self.pairs, margin)

    @property
    def fixed(self) -> tuple[int, ...]:
        """Numbers of the scenarios in which only the first driver has a failure at fault."""
        return self._at_fault.only_first

    @property
    def broken(self) -> tuple[int, ...]:
        """Numbers of the scenarios in which only the second driver has a failure at fault."""
        return self._at_fault.only_second

    @property
    def _at_fault(self) -> Pairs:
        return next(row for row in self.pairs if row.outcome == AT_FAULT)

    def to_pandas(self) -> "pd.DataFrame":
        """Return the paired statistics as a DataFrame; see `behavexplor.api.dataframes.frame_of_pairs`.

        Raises:
            InputError: if pandas is not installed.
        """
        return frame_of_pairs(self.pairs)

    def report(self, path: str | Path | None = None, *, replays: int = 100) -> Path:
        """Write the comparison and the findings of both runs as one self-contained HTML page.

        Args:
            path: the file to write; by default comparison.html in the folder.
            replays: greatest number of replays of each run.

        Returns:
            The path of the page.

        Raises:
            InputError: if the number of replays is out of range, or the page cannot be written.
        """
        runs = [read_run(run.folder) for run in (self.first, self.second)]
        text = page(runs, replays, self.pairs)
        return written(self.folder / PAGE if path is None else Path(path), text)

    def __repr__(self) -> str:
        found = self._at_fault
        return f"<Comparison {self.folder}: {found.n} scenarios, {len(self.fixed)} fixed, {len(self.broken)} broken>"

    def _repr_html_(self) -> str:
        found = self._at_fault
        first, second = (escape(run.config.ads) for run in (self.first, self.second))
        title = f"{found.n} scenarios of {escape(self.first.config.env)}; A is {first}, B is {second}"
        head = "".join(f"<th>{escape(name)}</th>" for name in COLUMNS)
        body = "".join(
            "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>" for cells in rows(self.pairs)
        )
        return (
            f"<p><b>{title}</b><br><code>{escape(str(self.folder))}</code></p><table><tr>{head}</tr>{body}</table>"
            f"<p>{LEGEND}</p>"
        )


def compare(  # noqa: PLR0913 - one argument for each choice
    first: Any,
    second: Any,
    env: str | gymnasium.Env[Any, Any] | None = None,
    *,
    scenarios: int = 1000,
    margin: float | None = None,
    seed: int = CampaignConfig.seed,
    specs: Sequence[Requirement] = (),
    env_config: Mapping[str, Any] | None = None,
    workers: int | None = None,
    out: str | Path | None = None,
    progress: bool | Observer | None = None,
    **settings: Any,
) -> Comparison:
    """Drive the same uniformly drawn scenarios with two drivers: what does the second one fix, and what does it break?

    The records are those of `behavexplor compare` with the same settings, byte for byte.

    Args:
        first: the first driver, such as a policy before it was trained further; see `behavexplor.find_failures`.
        second: the second driver. In highway-env's own environments, it drives in the scene of the first one, with its
            own observations and actions.
        env: see `behavexplor.find_failures`; by default the environment in which the first model was trained.
        scenarios: number of scenarios; with a margin, the greatest number.
        margin: the comparison ends when `Comparison.decision` has a verdict for this margin; None to drive in all.
        seed: seed of the drawn scenarios.
        specs: see `behavexplor.find_failures`.
        env_config: see `behavexplor.find_failures`.
        workers: see `behavexplor.find_failures`.
        out: folder for both run folders, new or empty; by default a new one in runs/.
        progress: see `behavexplor.find_failures`; shown for one driver after the other.
        settings: further keys of the configuration, see `behavexplor.campaign.config.CampaignConfig`.

    Raises:
        InputError: if an argument cannot be used.
        KeyboardInterrupt: after Ctrl-C. A comparison cannot be resumed.
        behavexplor.campaign.campaign.ExecutionError: if a scenario could not be executed for a reason other than the
            driver.
    """
    if fixed := sorted({*SETTINGS, "budget"} & settings.keys()):
        raise InputError(
            f"A comparison drives both drivers through the same uniformly drawn scenarios, so {fixed[0]} cannot be "
            "chosen: give scenarios and seed"
        )
    pair_campaigns.check_numbers(scenarios, margin)
    one, other = given_driver(first), given_driver(second)
    values = {**SETTINGS, "budget": str(scenarios), "seed": seed, **settings}
    config = config_of(one, env, env_config, specs, **values)
    for given in (one, other):  # before the first one drives, which may take hours
        worker_count(given, replace(config, ads=given.name).target, workers)
    folder = Path(out) if out is not None else stamped_folder("compare")
    pair_campaigns.check_new(folder)
    try:
        goes_on = False
        for budget in pair_campaigns.looks(scenarios, margin):
            config = replace(config, budget=str(budget))
            conduct(config, folder / FIRST, one, workers=workers, progress=progress, resume=goes_on)
            again = second_config(config, other.name, folder / FIRST)
            conduct(again, folder / SECOND, other, workers=workers, progress=progress, resume=goes_on)
            goes_on = True
            if margin is not None and Comparison(folder, one, other).decision(margin).found:
                break
    except Interrupted as error:
        raise KeyboardInterrupt(f"The comparison in {folder} is not complete") from error
    return Comparison(folder, one, other)
