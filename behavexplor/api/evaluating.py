"""Rates of arrival and violations of a driver, and a board that ranks several drivers by them, from Python."""

import json
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from math import inf
from pathlib import Path
from typing import Any, Final

import gymnasium

from behavexplor.ads.in_memory import given_driver
from behavexplor.ads.sb3.description import WEIGHTS
from behavexplor.api.conducting import in_this_process, worker_count
from behavexplor.api.given_environments import environment_of, given_config
from behavexplor.api.rate_folder import CARD, RateFolder
from behavexplor.campaign.config import CampaignConfig, campaign_config, check_said_twice, read_yaml
from behavexplor.data.trace import ARRIVED
from behavexplor.errors import InputError, brief
from behavexplor.evaluation import Evaluation, estimate_rates, start_judge
from behavexplor.execution.start import logical_of_target
from behavexplor.judge.rates import ALPHA, AT_FAULT, FAILED, Goal, check_outcome
from behavexplor.judge.specs import SPECS
from behavexplor.report.rendering import rendered
from behavexplor.report.run_page import written

BOARD: Final = "board.html"
_SUFFIXES: Final = (".zip", ".npz", *WEIGHTS)  # of policy files
_OF_ALL: Final = frozenset({"scenarios", "out", "goal", "alpha", "observe"})  # what the drivers of a board share
_UNUSED: Final = frozenset({"method", "options", "budget", "batch", "specs", "revision"})  # keys of searches only


def evaluate(  # noqa: PLR0913 - one argument for each choice
    driver: Any,
    env: str | gymnasium.Env[Any, Any] | None = None,
    *,
    scenarios: int = 1000,
    seed: int = 0,
    goal: Goal | None = None,
    env_config: Mapping[str, Any] | None = None,
    workers: int | None = None,
    out: str | Path | None = None,
    alpha: float = ALPHA,
    observe: Callable[[int], None] | None = None,
    **settings: Any,
) -> Evaluation:
    """Drive uniformly drawn scenarios, and count how often a driver arrives, collides and touches illegal lines.

    Args:
        driver: see `behavexplor.find_failures`.
        env: see `behavexplor.find_failures`.
        scenarios: number of scenarios.
        seed: seed of the drawn scenarios.
        goal: question about a rate. The evaluation ends as soon as it is answered, at the latest after `scenarios`.
        env_config: see `behavexplor.find_failures`.
        workers: see `behavexplor.find_failures`.
        out: folder for the outcomes, a card, and the run `failures`; None to write nothing. The same call with it goes
            on after an interruption.
        alpha: probability with which an interval of the card may miss its rate.
        observe: function that gets the number of finished scenarios.
        settings: further keys of the configuration that tell how to drive, see
            `behavexplor.campaign.config.CampaignConfig`.

    Raises:
        InputError: if an argument cannot be used.
    """
    if unused := sorted(_UNUSED & settings.keys()):
        raise InputError(
            f"An evaluation draws scenarios uniformly and has no use for {unused[0]}: give scenarios and seed"
        )
    if scenarios < 1:
        raise InputError(f"scenarios must be at least 1, got {scenarios}")
    if not 0.0 < alpha < 1.0:
        raise InputError(f"alpha must lie between 0 and 1, got {alpha}")
    if not (goal is None or isinstance(goal, Goal)):
        raise InputError(f"goal must be a behavexplor.Goal, got {brief(goal)}")
    given = given_driver(driver)
    name, changes = environment_of(given.env_or_trained_in(env) or CampaignConfig.env)
    values = {"env": name, "ads": given.name, "env_config": given_config(changes, env_config), **settings}
    config = campaign_config({**values, "seed": seed})
    count = worker_count(given, config.target, workers)
    with ExitStack() as stack:
        folder = None if out is None else stack.enter_context(closing(RateFolder(Path(out), config)))
        stack.enter_context(in_this_process(count))
        executor = start_judge(config.target, count, given.driver)
        try:
            logical = logical_of_target(executor, config.env)
            file = None if folder is None else folder.file
            found = estimate_rates(executor, logical, scenarios, seed, observe, goal=goal, file=file)
        finally:
            executor.shutdown(wait=False)
        if folder is not None:
            folder.store_failures(logical, found.n, count, driver=given.driver)
            folder.write_card({given.name: found}, alpha)
    return found


def listed(policies: str | Path | Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the settings of `evaluate` for each driver that `board` evaluates, by name.

    Raises:
        InputError: if there are none, or the file or an entry cannot be used.
    """
    if isinstance(policies, Mapping):
        found = dict(policies)
    elif (path := Path(policies)).is_dir():
        found = {file.stem: {"ads": str(file)} for file in sorted(path.iterdir()) if file.suffix in _SUFFIXES}
    else:
        found = read_yaml(path)
    for name, entry in found.items():
        if not (isinstance(entry, Mapping) and "ads" in entry):
            raise InputError(
                f"{policies}: expected drivers by name, each with its `ads`, as in careful: {{ads: careful}}"
            )
        if not (isinstance(name, str) and re.fullmatch(r"\w[\w.-]*", name)):
            raise InputError(
                f"{policies}: the name {name!r:.80} becomes that of a folder, and must consist of letters, digits, _, "
                "- and dots, beginning with a letter, digit or _"
            )
        if shared := sorted(_OF_ALL & entry.keys()):
            raise InputError(f"{policies}: {name} has the key {shared[0]!r}, which all drivers share: remove it")
    if not found:
        raise InputError(f"{policies} has no policy")
    return {name: dict(entry) for name, entry in found.items()}


def board(
    policies: str | Path | Mapping[str, Mapping[str, Any]],
    out: str | Path,
    *,
    outcome: str = FAILED,
    scenarios: int = 1000,
    observe: Callable[[int], None] | None = None,
    **settings: Any,
) -> Path:
    """Evaluate several drivers, and rank them on a page. The same call goes on after an interruption.

    Args:
        policies: settings of `evaluate` by name, with the driver as `ads`, and perhaps a `source` that the page shows;
            a YAML file of them; or a folder of policy files.
        out: folder for the page, and below it one for each driver, see `evaluate`.
        outcome: outcome by whose rate they are ranked, in each environment.
        scenarios: number of scenarios of each.
        observe: function that gets the number of evaluated drivers.
        settings: settings of `evaluate` where an entry has none of its own.

    Returns:
        The path of the page. The error probability of its intervals is divided by the number of drivers.

    Raises:
        InputError: if an argument or an entry cannot be used.
    """
    check_outcome(outcome)
    entries, folder, cards = listed(policies), Path(out), []
    alpha = ALPHA / len(entries)
    for name, entry in entries.items():
        check_said_twice(entry, settings, str(policies))
        values = {**settings, **entry, "scenarios": scenarios, "out": folder / name, "alpha": alpha}
        source, ads = values.pop("source", ""), values.pop("ads")
        try:
            evaluate(ads, **values)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        cards.append({**json.loads((folder / name / f"{CARD}.json").read_text()), "name": name, "source": source})
        if observe is not None:
            observe(len(cards))
    return written(folder / BOARD, _page(cards, outcome, alpha))


def _page(cards: Sequence[Mapping[str, Any]], outcome: str, alpha: float) -> str:
    """Return the page that ranks drivers by their cards. Rates in different environments cannot be compared."""
    shown = list(dict.fromkeys((outcome, FAILED, AT_FAULT, SPECS[0].name, ARRIVED)))
    rows, ranked = [], Counter[str]()  # number of ranked drivers by environment
    for card in sorted(cards, key=lambda card: (card["env"], card["rates"].get(outcome, {"rate": inf})["rate"])):
        ranked[card["env"]] += 1
        rows.append({**card, "rank": ranked[card["env"]]})
    heads = ["", "driver", *shown, "scenarios", "classes", "SHA-256"]
    values = {"rows": rows, "heads": heads, "shown": shown, "outcome": outcome, "alpha": alpha}
    return rendered("board.html.jinja", ("theme.js", "board.js"), several=len(ranked) > 1, **values)
