"""The folder of an evaluation: its outcomes, its failures as a run, and a card of what may be said of the driver."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

from behavexplor.ads.interface import ADS
from behavexplor.campaign.config import CONFIG, CampaignConfig
from behavexplor.campaign.opening import opened
from behavexplor.campaign.run_summary import summarize
from behavexplor.campaign.same_driver import identity_of
from behavexplor.data.durable import folder_in, write_durably
from behavexplor.data.logical import LogicalScenario
from behavexplor.errors import InputError
from behavexplor.evaluation import Evaluation, failing
from behavexplor.fuzz.methods import GIVEN
from behavexplor.judge.outcomes import OutcomeFile
from behavexplor.judge.rates import ALPHA, AT_FAULT, FAILED

OUTCOMES, FAILURES, SCENARIOS, CARD = "outcomes.jsonl", "failures", "failures.jsonl", "card"
MOST_STORED: Final = 1000  # failures that are driven again and kept with their traces
CLAUSE: Final = "of the scenarios that {} draws in this configuration, which says nothing about roads"
_BATCH: Final = 32
_SUBJECT: Final = ("env", "ads", "seed", "env_config", "traffic", "stochastic", "activation")


class RateFolder:
    """The folder of an evaluation, new or that of the same evaluation, which then goes on.

    Args:
        path: the folder.
        config: the driver, its environment and the seed of the scenarios.

    Attributes:
        path: the folder.
        file: the outcomes.
        run: the run folder of the failures, if there are any.

    Raises:
        InputError: if the folder cannot be used, or belongs to another evaluation.
    """

    def __init__(self, path: Path, config: CampaignConfig) -> None:
        try:
            self.path = folder_in(path)
        except OSError as error:
            raise InputError(f"The folder {path} cannot be written: {error.strerror}") from None
        identity = identity_of(config)
        self._config = config
        self._driver = {"digests": dict(identity.digests), "libraries": dict(identity.libraries)}
        self._subject = {name: getattr(config, name) for name in _SUBJECT}
        self.file, self.run = OutcomeFile(path / OUTCOMES, {**self._subject, **self._driver}), path / FAILURES

    def store_failures(
        self, logical: LogicalScenario, n: int, workers: int, observe: Callable[[int], None], driver: ADS | None = None
    ) -> None:
        """Drive the first failures again as a run, which has their traces.

        Args:
            logical: logical scenario of the environment.
            n: number of evaluated scenarios.
            workers: see `behavexplor.campaign.opening.opened`.
            observe: function that gets the number of failures that have been driven.
            driver: see `behavexplor.campaign.opening.opened`.

        Raises:
            InputError: see `behavexplor.campaign.opening.opened`.
            behavexplor.campaign.campaign.ExecutionError: if one could not be driven.
        """
        found = islice(failing(self.file, logical, self._config.seed, n), MOST_STORED)
        lines = [json.dumps(scenario.to_dict(), separators=(",", ":")) + "\n" for _, scenario in found]
        goes_on = (self.run / CONFIG).is_file()
        if not lines or (goes_on and summarize(self.run).executions >= len(lines)):
            return
        listed = self.path / SCENARIOS
        write_durably(listed, "".join(lines))
        options, budget = {"file": str(listed.resolve())}, str(len(lines))
        config = replace(self._config, method=GIVEN, options=options, budget=budget, batch=_BATCH)
        with opened(config, self.run, workers, resume=goes_on, driver=driver) as ready:
            ready.campaign.run(lambda progress: observe(progress.executions))

    def write_card(self, found: Mapping[str, Evaluation], alpha: float = ALPHA) -> dict[str, Any]:
        """Write the card as JSON and in Markdown, and return its values.

        Args:
            found: the evaluation of the driver, and those of what it is compared with, by name.
            alpha: probability with which an interval may miss its rate.

        Raises:
            InputError: if it cannot be written.
        """
        classes = summarize(self.run).classes if (self.run / CONFIG).is_file() else ()
        counted = [{"class": one.id, "words": one.words, "failures": one.count} for one in classes]
        card = {**card_values(self._config.env, found, alpha), "classes": counted, **self._subject, **self._driver}
        try:
            write_durably(self.path / f"{CARD}.json", json.dumps(card, indent=1) + "\n")
            write_durably(self.path / f"{CARD}.md", markdown(card))
        except OSError as error:
            raise InputError(f"The card in {self.path} cannot be written: {error.strerror}") from None
        return card


def card_values(env: str, found: Mapping[str, Evaluation], alpha: float = ALPHA) -> dict[str, Any]:
    """Return what may be said of a driver's rates, as JSON values; see `RateFolder.write_card`."""
    (_, own), *others = found.items()
    rates = {}
    for outcome in (*own.counts, FAILED, AT_FAULT):
        low, high = own.interval(outcome, alpha) if own.decision is None else (None, None)  # else only that one holds
        rates[outcome] = {"count": own.count(outcome), "rate": own.rate(outcome), "low": low, "high": high}
    decision = own.decision
    return {
        "scenarios": own.n,
        "alpha": alpha,
        "rates": rates,
        "decision": None if decision is None else {**asdict(decision), "words": decision.words},
        "beside": {name: {"scenarios": one.n, **one.counts} for name, one in others},
        "clause": CLAUSE.format(env),
    }


def markdown(card: Mapping[str, Any]) -> str:
    """Return a card in Markdown, such as for a section of a model card."""
    head = f"# How often {Path(card['ads']).name} fails in {card['env']}"
    claims = [f"{card['decision']['words']}, {card['clause']}."] if card["decision"] else []
    kind = f"{100 * (1 - card['alpha']):g} % interval"
    rates = [
        (
            name,
            one["count"],
            f"{one['rate']:.3%}",
            "" if one["low"] is None else f"{one['low']:.3%} to {one['high']:.3%}",
        )
        for name, one in card["rates"].items()
    ]
    seed = f"{card['scenarios']} scenarios, seed {card['seed']}. These are rates {card['clause']}."
    parts = [head, *claims, seed, _table(("outcome", "scenarios", "rate", kind), rates)]
    beside = [(name, *one.values()) for name, one in card["beside"].items()]
    if beside:
        first = next(iter(card["beside"].values()))
        parts += ["## Beside it", _table(("driver", *first), beside)]
    if card["classes"]:
        rows = [(one["words"], one["failures"]) for one in card["classes"]]
        parts += [f"## Classes of failures (of the first {MOST_STORED})", _table(("class", "failures"), rows)]
    stated = [(name, card[name]) for name in _SUBJECT if card[name] not in (None, False)]
    stated += [*card["digests"].items(), *card["libraries"].items()]
    return "\n\n".join([*parts, "## What was evaluated", _table(("", ""), stated)]) + "\n"


def _table(heads: tuple[Any, ...], rows: list[tuple[Any, ...]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ("---",) * len(heads), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines)
