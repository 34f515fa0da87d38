"""Configuration of a campaign: read from file and flags, validated, written to the run folder; and names of folders."""

import math
import os
import re
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, Final, Self

import yaml
from pydantic import ConfigDict

from behavexplor.campaign.folder_format import CONFIG
from behavexplor.data.target import Conditions, Target
from behavexplor.data.untrusted import parse_yaml, read_file
from behavexplor.data.validation import checked
from behavexplor.errors import InputError, brief, unknown_name

REVISION: Final = 3  # see `CampaignConfig.revision`; raise it with every change after which campaigns differ
MAX_FILE_SIZE = 100_000  # [bytes]; a configuration has a few hundred
RUNS: Final = Path("runs")  # parent folder of run folders that were given no name, and of an experiment's runs
LATEST: Final = "latest"  # in `RUNS`, a link to the run that began or went on last
_LONGEST: Final = 40  # of a part of the name of a run folder [characters]


@dataclass(frozen=True)
class Budget:
    """Budget of a campaign: a number of executions, or a running time."""

    executions: int | None = None  # number of executions; None if the budget is a time
    seconds: float | None = None  # running time [s]; None if the budget is a number of executions

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse a budget such as "750", "30m" or "1h30m".

        Raises:
            InputError: if the text is neither a number nor a time, or if it is zero.
        """
        if re.fullmatch(r"\d{1,9}", text) and int(text) > 0:
            return cls(executions=int(text))
        parts = re.fullmatch(r"(?:(\d+(?:\.\d+)?)h)?(?:(\d+(?:\.\d+)?)m)?(?:(\d+(?:\.\d+)?)s)?", text)
        amounts = parts.groups(default="0") if parts else ()
        seconds = sum(float(amount) * unit for amount, unit in zip(amounts, (3600, 60, 1), strict=False))
        if not 0 < seconds < math.inf:
            raise InputError(
                f"The budget {text!r} is neither a number of executions (750) nor a time (90s, 30m, 1h30m)"
            )
        return cls(seconds=seconds)


@dataclass(frozen=True)
class CampaignConfig(Target):
    """One search method x ADS x environment x seed, with a budget. `Target` has the inherited fields.

    Attributes:
        method: Search method, or package.module:attribute of your own.
        budget: Number of executions (750), or running time (90s, 30m, 1h30m).
        seed: Random seed. The same seed gives the same records.
        batch: Number N of scenarios in flight. Each is chosen without the results of the N - 1 before it; 1 is the
            paper's sequential loop. What needs no result, such as uniform draws, keeps all workers busy anyhow.
        specs: Additional requirement, as package.module:attribute, a function of a trace (docs/specs.md).
        options: Options of the search method; see its `Options`.
        revision: Revision of the search methods, the environments and the judgment. The same campaign has the same
            records in all versions of this program with the same revision. Campaigns of other revisions can be read,
            but not continued.

    Raises:
        InputError: if a value is out of range.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    method: str = "behavexplor"  # a key of `behavexplor.fuzz.methods.METHODS`, or "package.module:attribute"
    budget: str = "750"
    seed: int = 0
    batch: int = 8
    specs: tuple[str, ...] = ()  # beside R1-R3; each as "package.module:attribute", see `behavexplor.judge.robustness`
    options: dict[str, Any] = field(default_factory=dict)
    revision: int = REVISION

    def __post_init__(self) -> None:
        super().__post_init__()
        Budget.parse(self.budget)
        if not 0 <= self.seed < 2**63:
            raise InputError(f"The seed {self.seed} must be a whole number from 0 to 2^63 - 1")
        if not 1 <= self.batch <= 10_000:
            raise InputError(f"The batch {self.batch} must lie between 1 and 10000")

    def stated(self) -> dict[str, Any]:
        """Return the fields by name, those of `Conditions` last. Fields that derived classes add are left out."""
        conditions = [one.name for one in fields(Conditions)]
        others = [one.name for one in fields(CampaignConfig) if one.name not in conditions]
        return {name: getattr(self, name) for name in (*others, *conditions)}

    def to_yaml(self) -> str:
        """Return the whole configuration as YAML, which reproduces the campaign when it is read from a file.

        Raises:
            InputError: if a value cannot be stored, such as a number of numpy in the options of the method.
        """
        values = self.stated() | {"trust": list(self.trust), "specs": list(self.specs)}
        try:
            return yaml.safe_dump(values, sort_keys=False)
        except yaml.representer.RepresenterError as error:
            what = brief(error.args[-1])
            raise InputError(f"The configuration cannot be stored: {what} is not plain data") from None


@dataclass(frozen=True)
class StoredConfig:
    """What a run folder says its campaign is. Anyone may have written it, so it may be shown and compared only.

    To execute something by it, make a configuration of it with `behavexplor.campaign.provenance.accepted`.
    """

    folder: Path
    unverified: CampaignConfig  # the configuration in it


def check_said_twice(values: Mapping[str, Any], given: Mapping[str, Any], file: str) -> None:
    """Check that `trust` and `unconfined` in a file were also given on the command line: a file alone does not count.

    Raises:
        InputError: if something was not; the message names the flag.
    """
    trusted = values.get("trust")
    for digest in trusted if isinstance(trusted, Iterable) and not isinstance(trusted, str) else ():
        if digest not in given.get("trust", ()):
            raise InputError(f"{file} trusts {digest}, which counts only on the command line: add --trust {digest}")
    if values.get("unconfined") and not given.get("unconfined"):
        raise InputError(f"{file} says `unconfined`, which counts only on the command line: add --unconfined")


def campaign_config(values: Mapping[str, Any]) -> CampaignConfig:
    """Return a configuration from plain values.

    Raises:
        InputError: if a value is unknown, of a wrong type or out of range; the message names the first such value.
    """
    budget = values.get("budget")
    if isinstance(budget, int) and not isinstance(budget, bool):  # YAML reads `budget: 750` as a number
        values = {**values, "budget": str(budget)}
    return checked(CampaignConfig, values, "configuration")


def read_config(
    name: str, *, what: str = "configuration (neither a file nor a preset)", folder: str = ""
) -> dict[str, Any]:
    """Read the values in the YAML file of a campaign or an experiment, or in a preset, such as "paper".

    `what` names the kind of file in the message, and `folder` is the presets' folder in `configs/`.

    Raises:
        InputError: if there is no such file, or if it holds no mapping.
    """
    path, shipped = Path(name), preset_folder() / folder
    if not path.is_file() and "/" not in name and (preset := shipped / f"{name}.yaml").is_file():
        path = preset
    if not path.is_file():
        raise unknown_name(what, name, [preset.stem for preset in shipped.glob("*.yaml")])
    return read_yaml(path)


def stored_config(run: Path) -> StoredConfig:
    """Return the configuration of the campaign in a run folder, which anyone may have written.

    Raises:
        InputError: if it is missing or damaged.
    """
    path = run / CONFIG
    if not run.exists():
        raise InputError(f"{run} is not a run folder: there is no such folder")
    if not path.is_file():
        inside = next(chain(run.glob(f"*/{CONFIG}"), (run / RUNS).rglob(CONFIG)), None)  # it may hold many campaigns
        way = f"name one that it holds, such as {inside.parent}" if inside else "restore the file or start a new run"
        raise InputError(f"{run} is not a run folder, or its {CONFIG} is missing: {way}")
    values = read_yaml(path)
    if not values:
        raise InputError(f"{path} is empty, so the configuration of the run is lost: restore it or start a new run")
    return StoredConfig(run, campaign_config({"revision": 1, **values}))  # in revision 1, files did not state it


def check_revision(config: CampaignConfig, what: str) -> None:
    """Refuse a campaign that this version would continue differently. `what` names it in the message.

    Raises:
        InputError: if the campaign has another revision.
    """
    if config.revision != REVISION:
        raise InputError(
            f"{what} is a campaign of revision {config.revision}, and this version of behavexplor runs revision "
            f"{REVISION}, whose results differ: continue it with the version that began it, or start a new one"
        )


def read_yaml(path: Path, example: str = "env: intersection-straight") -> dict[str, Any]:
    """Read the keys and values in a YAML file; none if it is empty. The error for other content shows the `example`.

    Raises:
        InputError: if the file cannot be read, is too long, or holds no mapping.
    """
    try:
        values = parse_yaml(read_file(path, MAX_FILE_SIZE, pipes=True).decode())
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise InputError(f"{path} is not a YAML file: {error!s:.300}") from None
    if values is None:
        return {}
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise InputError(f"{path} must contain keys and values, such as `{example}`")
    return values


def preset_folder() -> Path:
    """Return the folder of presets: beside the package in a checkout, or inside an installed package."""
    package = Path(__file__).parent.parent
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def run_folder(config: CampaignConfig, root: Path = RUNS) -> Path:
    """Return an unused folder for a campaign, named after its configuration and the current time."""
    parts = [_part_of_name(name) for name in (config.env, config.ads, config.method)]
    return stamped_folder("-".join([*parts, str(config.seed)]), root)


def _part_of_name(name: str) -> str:
    """Return a name, such as that of a policy's file, as part of the name of a folder."""
    last = name.rstrip("/").rsplit("/", 1)[-1].removesuffix(".zip")
    return re.sub(r"[^\w.-]", "-", last)[:_LONGEST]


def stamped_folder(name: str, root: Path = RUNS) -> Path:
    """Return an unused folder that is named after its contents and the current time."""
    stamped = f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
    taken = sum(1 for _ in root.glob(f"{stamped}*"))
    return root / (f"{stamped}-{taken + 1}" if taken else stamped)


def point_to_latest(folder: Path) -> None:
    """Let the link `LATEST` in `RUNS` lead to a run folder, if that is in `RUNS` itself and the system has links."""
    link = folder.parent / LATEST
    is_users = link.exists() and not link.is_symlink()
    if folder.parent != RUNS or is_users or folder.is_symlink():  # a link, perhaps this one, leads to a run already
        return
    new = folder.parent / f".{LATEST}-{os.getpid()}"
    with suppress(OSError):
        new.symlink_to(folder.name)
        new.replace(link)
