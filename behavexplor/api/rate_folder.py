"""The folder of an evaluation: its outcomes, its failures as a run, and a card of what may be said of the driver."""

import json
import weakref
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import asdict, replace
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import numpy as np

from behavexplor.ads.interface import ADS
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.database_file import lock_folder
from behavexplor.campaign.folder_format import CONFIG, LOCK
from behavexplor.campaign.opening import opened
from behavexplor.campaign.run_summary import summarize
from behavexplor.campaign.same_driver import identity_of
from behavexplor.campaign.store import Store
from behavexplor.data.durable import make_folder, new_file, write_durably, writing
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.target import OF_EPISODES
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError
from behavexplor.evaluation import Evaluation, Observe, failing
from behavexplor.fuzz.methods import GIVEN
from behavexplor.judge.fault import is_at_fault, touched_npc
from behavexplor.judge.outcomes import OutcomeFile
from behavexplor.judge.rates import ALPHA, AT_FAULT, FAILED
from behavexplor.judge.specs import ERROR
from behavexplor.report.drawing import decisive_frame, draw, footage_of
from behavexplor.report.rendering import filled
from behavexplor.report.road_shapes import known_road
from behavexplor.report.run_page import written

# names in the folder
OUTCOMES, FAILURES, SCENARIOS, CARD, PICTURE = "outcomes.jsonl", "failures", "failures.jsonl", "card", "card.png"
MOST_STORED: Final = 1000  # failures that are driven again and kept with their traces
CLAUSE: Final = "of the scenarios that {} draws in this configuration, which says nothing about roads"
_BATCH: Final = 32
_SUBJECT: Final = ("env", "ads", "seed", *OF_EPISODES)  # keys of the configuration that decide the outcomes


class RateFolder:
    """The folder of an evaluation: a new one, or one in which the same evaluation goes on.

    The configuration says the driver, its environment and the seed of the scenarios. `run` is the run folder of the
    failures, if there are any. The folder is locked against other evaluations until `close` is called.

    Raises:
        InputError: if the folder cannot be used, is in use, or belongs to another evaluation.
    """

    def __init__(self, path: Path, config: CampaignConfig) -> None:
        with writing(f"The folder {path}"):
            self.path = make_folder(path)
            if {one.name for one in path.iterdir()} - {LOCK} and not (path / OUTCOMES).is_file():  # one may be replaced
                raise InputError(f"{path} is not empty, and holds no evaluation that could go on: name another folder")
            self.close = weakref.finalize(self, lock_folder(path).close)
        identity = identity_of(config)
        self._config = config
        self._driver = {"digests": dict(identity.digests), "libraries": dict(identity.libraries)}
        self._subject = {name: getattr(config, name) for name in _SUBJECT}
        self.run = path / FAILURES
        try:
            self.file = OutcomeFile(path / OUTCOMES, {**self._subject, **self._driver})
        except InputError:
            self.close()  # a notebook keeps the error, and with it this object
            raise

    def store_failures(
        self,
        logical: LogicalScenario,
        n: int,
        workers: int,
        observe: Observe = lambda _: None,
        driver: ADS | None = None,
    ) -> None:
        """Drive the first failures among n scenarios again as a run, which has their traces.

        `observe` gets the number of failures that have been driven. See `behavexplor.campaign.opening.opened` for the
        rest, and for what is raised.
        """
        found = islice(failing(self.file, logical, self._config.seed, n), MOST_STORED)
        lines = [json.dumps(scenario.to_dict(), separators=(",", ":")) + "\n" for _, scenario in found]
        goes_on = (self.run / CONFIG).is_file()
        with suppress(InputError):  # a full disk may have left a run without any execution
            if not lines or (goes_on and summarize(self.run).executions >= len(lines)):
                return
        listed = self.path / SCENARIOS
        with writing(listed):
            write_durably(listed, "".join(lines))
        options, budget = {"file": str(listed.resolve())}, str(len(lines))
        config = replace(self._config, method=GIVEN, options=options, budget=budget, batch=_BATCH)
        with opened(config, self.run, workers, resume=goes_on, driver=driver) as ready:
            ready.campaign.run(lambda progress: observe(progress.executions))

    def write_card(self, found: Mapping[str, Evaluation], alpha: float = ALPHA) -> dict[str, Any]:
        """Write the card as JSON and in Markdown, with a picture of the hardest collision, and return its values.

        The first evaluation is that of the driver, the others are what it is compared with, by name. `alpha` is the
        probability with which an interval may miss its rate.

        Raises:
            InputError: if it cannot be written.
        """
        (_, own), *others = found.items()
        outcomes = dict.fromkeys((*own.counts, FAILED, AT_FAULT, ERROR))
        has_failures = (self.run / CONFIG).is_file()
        classes = summarize(self.run).classes if has_failures else ()
        card = {
            "scenarios": own.n,
            "alpha": alpha,
            "rates": {outcome: _rate(own, outcome, alpha) for outcome in outcomes},
            "decision": own.decision and {**asdict(own.decision), "words": own.decision.words},
            "beside": {name: {"scenarios": one.n, **one.counts} for name, one in others},
            "clause": CLAUSE.format(self._config.env),
            "classes": [{"class": one.id, "words": one.words, "failures": one.count} for one in classes],
            "hardest": self._hardest() if has_failures else None,
            **self._subject,
            **self._driver,
        }
        stated = {**self._subject, **self._driver["digests"], **self._driver["libraries"]}
        shown = [name for name in own.counts if ": " not in name]
        text = filled("card.md.jinja", escapes=False, card=card, stated=stated, shown=shown, most=MOST_STORED)
        written(self.path / f"{CARD}.json", json.dumps(card, indent=1) + "\n")
        written(self.path / f"{CARD}.md", text)
        return card

    def _hardest(self) -> dict[str, Any] | None:
        """Draw the hardest collision at fault, and describe it; None if there is none."""
        with closing(Store.read(self.run)) as store:
            crashes = (one for one in store.executions() if one.record.fault and is_at_fault(one.record.fault))
            hardest = max(((one, impact(one.load_trace())) for one in crashes), key=itemgetter(1), default=None)
        if hardest is None:
            return None
        execution, speed = hardest
        footage = footage_of(execution, known_road(self._config.env, self.run))
        picture = draw(footage, decisive_frame(footage.trace, footage.violated))
        with writing(f"The picture {self.path / PICTURE}"), new_file(self.path / PICTURE) as file:
            picture.save(file, "PNG")
        return {"execution": execution.id, "impact": round(speed, 2), "picture": PICTURE}


def impact(trace: Trace) -> float:
    """Return the speed of the ego relative to what it touches in the last frame, one frame earlier [m/s]."""
    npc, velocity = touched_npc(trace), trace.velocity[max(len(trace.time) - 2, 0)]
    return float(np.linalg.norm(velocity[0] - (0.0 if npc is None else velocity[npc])))


def _rate(found: Evaluation, outcome: str, alpha: float) -> dict[str, float | None]:
    """Return count, rate and interval of an outcome. The interval is None if the evaluation ended at a decision."""
    low, high = found.interval(outcome, alpha) if found.decision is None else (None, None)
    return {"count": found.count(outcome), "rate": found.rate(outcome), "low": low, "high": high}
