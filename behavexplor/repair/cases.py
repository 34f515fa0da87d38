"""Suites and their cases as plain data, a folder with YAML files; and how failures of runs become cases."""

import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Self

import yaml

from behavexplor.campaign.config import CampaignConfig, read_yaml
from behavexplor.campaign.provenance import Claim, code_of, own_digests, remember
from behavexplor.campaign.record import ERROR, Record
from behavexplor.campaign.same_driver import driver_digests
from behavexplor.campaign.store import Store
from behavexplor.data.drawn_scenario import DEFAULT, Traffic
from behavexplor.data.durable import check_no_file, make_folder, write_durably, writing
from behavexplor.data.scenario import Scenario, read_scenario
from behavexplor.data.target import OF_EPISODES, Activation, CheckedTarget
from behavexplor.data.trace import Trace
from behavexplor.data.untrusted import read_file
from behavexplor.data.validation import checked
from behavexplor.errors import InputError
from behavexplor.judge.classes import violation_class
from behavexplor.judge.fault import is_at_fault
from behavexplor.judge.robustness import load_specs
from behavexplor.judge.specs import judge
from behavexplor.triage.findings import Finding, Minimized, minimized_trace_path

SUITE_FORMAT: Final = 1
SUITE: Final = "suite.yaml"
CASES: Final = "scenarios"
TEST: Final = "test_scenarios.py"
_TEST_TEXT: Final = '''\
"""Every scenario of this folder as a test. The driver is that of suite.yaml, or the one that ADS names:

    ADS=my_driver:MyDriver pytest test_scenarios.py
"""

import os
from pathlib import Path

import pytest

from behavexplor.testing import Suite, opened_driver

SUITE = Suite.read(Path(__file__).parent)


@pytest.fixture(scope="module")
def drive():
    with opened_driver(SUITE, os.environ.get("ADS"), trust=os.environ.get("TRUST", "").split()) as drive:
        yield drive


@pytest.mark.parametrize("case", SUITE.cases, ids=lambda case: case.name)
def test_scenario(case, drive):
    outcome = drive(case)
    assert outcome.passed, outcome.words
'''  # it is code, so no name from a run, such as the driver's, is put into it


@dataclass(frozen=True, kw_only=True)
class Case:
    """A scenario in which a driver failed once."""

    words: str  # what happened, as a sentence
    class_id: str  # class of the failure
    run: str  # name of the run in which it was found
    execution: int  # number of the execution in which it was found
    fault: str | None = None  # fault for a collision; None for another failure
    cause: str | None = None  # weakness of the rule planner that caused the failure, if triage has found it
    # names of the specs that must hold. A collision that another vehicle caused violates none of them.
    holds: tuple[str, ...]
    scenario: dict[str, Any]  # the scenario as `behavexplor.data.scenario.Scenario.to_dict` gives it

    @property
    def name(self) -> str:
        """Name of the case and of its file."""
        return re.sub(r"[^\w-]+", "-", f"{self.class_id}-{self.execution}")

    def file(self, suite: Path) -> Path:
        """Return the file of the case in the folder of a suite."""
        return suite / CASES / f"{self.name}.yaml"

    def load_scenario(self) -> Scenario:
        """Return the scenario.

        Raises:
            InputError: if it is not valid; the message names the field.
        """
        return read_scenario(dict(self.scenario))


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Scenarios in which a driver failed once, and where they are driven."""

    env: str  # name of the environment
    driver: str  # name of the driver that failed. In the file, the path of a policy is meant from the suite's folder.
    specs: tuple[str, ...] = ()  # names of the user's specs
    # configuration of the environment, as far as it differs from what a driver declares
    env_config: Mapping[str, Any] = field(default_factory=dict)
    traffic: Traffic = DEFAULT  # kind of traffic in a highway-env environment
    stochastic: bool = False  # whether the driver that failed drew its actions. It does so in checks, too.
    activation: Activation | None = None  # function between the layers of this driver, if it is a file of weights
    # SHA-256 of the files of this driver, see `behavexplor.campaign.same_driver.driver_digests`
    digests: Mapping[str, str] = field(default_factory=dict)
    cases: tuple[Case, ...] = ()  # in the order of their files if read from a folder, or else as they were found

    def target(self, ads: str, **settings: Any) -> CheckedTarget:
        """Return the target that drives the cases with a driver.

        The settings are further fields of the target. For the driver that failed, the suite says what they do not.
        """
        config = dict(self.env_config)
        if self.cases:
            config |= min(self.cases, key=lambda case: case.name).load_scenario().scene_config
        own = self._own_settings() if ads == self.driver else {}
        settings = {**own, **{name: value for name, value in settings.items() if value or name not in own}}
        return CheckedTarget(self.env, ads, env_config=config or None, traffic=self.traffic, **settings)

    def _own_settings(self) -> dict[str, Any]:
        """Return what was said about the driver that failed."""
        said = {"stochastic": self.stochastic, "activation": self.activation}
        return {name: value for name, value in said.items() if value}

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read a suite from its folder. Nothing that it names is imported; see `behavexplor.repair.checking`.

        Raises:
            InputError: if a file is missing or wrong; the message names it.
        """
        if not (folder / SUITE).is_file():
            raise InputError(f"{folder} is not a suite: it has no {SUITE}; `behavexplor suite` writes one from a run")
        values = dict(read_yaml(folder / SUITE))
        found = values.pop("format", None)
        if found != SUITE_FORMAT:
            raise InputError(f"{folder / SUITE} has format {found}, but this version reads format {SUITE_FORMAT}")
        paths = sorted(path for path in (folder / CASES).glob("*.yaml") if path.is_file())
        if not paths:
            raise InputError(f"{folder / CASES} has no scenarios")
        cases = [checked(Case, read_yaml(path), str(path)) for path in paths]
        suite = checked(cls, values, str(folder / SUITE))
        for path, case in zip(paths, cases, strict=True):
            try:
                case.load_scenario()
            except InputError as error:
                raise InputError(f"{path}: scenario: {error}") from None
        driver = folder / suite.driver
        return replace(suite, driver=str(driver) if driver.exists() else suite.driver, cases=tuple(cases))

    @property
    def claim(self) -> Claim:
        """What the suite says that may have code run."""
        target = self.target(self.driver)
        config = None if target.env_config is None else dict(target.env_config)
        said = {name: value for name, value in asdict(self).items() if value is not None}
        values = {name: value for name, value in said.items() if name not in ("cases", "digests")}
        values["driver"] = Path(self.driver).name  # whose path depends on the working directory
        code = code_of(self.env, self.driver, "", self.specs, config)
        return Claim(Path(SUITE), {**values, "env_config": config}, code, self.driver, hint=", or name it by --ads")

    def write(self, folder: Path) -> None:
        """Write the suite and its test file into a folder, or nothing if that fails.

        Raises:
            InputError: if the folder is not new or empty, or cannot be written.
        """
        check_free(folder)
        remember(own_digests(self.claim))  # without it, the suite must be trusted, as on another machine
        with writing(folder), _all_or_nothing(folder):
            make_folder(folder, CASES)
            for case in self.cases:
                write_durably(case.file(folder), _case_text(case))
            write_durably(folder / TEST, _TEST_TEXT)
            values: dict[str, Any] = {
                "env": self.env,
                "driver": os.path.relpath(self.driver, folder) if Path(self.driver).exists() else self.driver,
                "specs": list(self.specs),
                "traffic": self.traffic,
            }
            values |= self._own_settings()
            if digests := driver_digests(self.driver, self.claim.code):
                values["digests"] = digests
            config = {"env_config": dict(self.env_config)} if self.env_config else {}
            write_durably(folder / SUITE, _yaml({"format": SUITE_FORMAT, **values, **config}))


@contextmanager
def _all_or_nothing(folder: Path) -> Iterator[None]:
    """Remove what was written into a folder, which was new or empty, if writing fails."""
    try:
        yield
    except OSError:
        shutil.rmtree(folder / CASES, ignore_errors=True)
        (folder / TEST).unlink(missing_ok=True)
        raise


def check_free(folder: Path) -> None:
    """Check that a folder is new or empty, so that a suite replaces nothing and mixes with nothing.

    Raises:
        InputError: if the folder is not.
    """
    try:
        check_no_file(folder)
        if folder.is_dir() and any(folder.iterdir()):
            raise InputError(f"{folder} is not empty: choose another folder for the suite")
    except OSError as error:
        raise InputError(f"{folder} cannot be used: {error.strerror}") from None


def _case_text(case: Case) -> str:
    """Return a case as YAML: what happened and what must hold, then the scenario."""
    values = {name: value for name, value in asdict(case).items() if value is not None}
    head = {name: value for name, value in values.items() if name != "scenario"}
    return _yaml({**head, "holds": list(case.holds)}) + _yaml({"scenario": case.scenario})


def _yaml(values: Mapping[str, Any]) -> str:
    """Return YAML in which lists and mappings without further ones in them take one line."""
    return yaml.safe_dump(dict(values), sort_keys=False, allow_unicode=True, width=110, default_flow_style=None)


def candidates(records: Iterable[Record], known: Mapping[int, Finding]) -> dict[str, list[int]]:
    """Return the numbers of the failures for which the driver was at fault, by class, in order.

    Findings of triage, by the numbers of the executions, replace the faults in the records.
    """
    found: dict[str, list[int]] = {}
    for record in records:
        fault = known[record.id].fault if record.id in known else record.fault
        is_drivers = record.at_fault and is_at_fault(fault) and record.violated != (ERROR,)
        if is_drivers and record.violation_class is not None:
            found.setdefault(record.violation_class, []).append(record.id)
    return found


def case_of(store: Store, config: CampaignConfig, minimal: Minimized) -> Case:
    """Return the case of a minimized failure."""
    specs = load_specs(config.specs)
    trace = Trace.from_bytes(read_file(minimized_trace_path(store.folder, minimal.id)))
    kind = violation_class(trace, judge(trace, specs).violated)
    return Case(
        words=kind.words if kind else minimal.class_id,
        class_id=minimal.class_id,
        run=store.folder.resolve().name,
        execution=minimal.id,
        fault=minimal.fault,
        cause=minimal.cause,
        holds=tuple(spec.name for spec in specs),
        scenario=minimal.scenario,
    )


def check_same_driving(first: tuple[Path, CampaignConfig], others: Iterable[tuple[Path, CampaignConfig]]) -> None:
    """Check that runs can be the source of one suite.

    Raises:
        InputError: if they were made in different environments, or judged by different specs.
    """
    for folder, config in others:
        for name in ("env", *OF_EPISODES, "specs"):
            own, other = getattr(first[1], name) or None, getattr(config, name) or None
            if own != other:
                raise InputError(
                    f"{folder} and {first[0]} cannot be in one suite: their {name} is {other!r} and {own!r}; "
                    "write one suite for each"
                )
