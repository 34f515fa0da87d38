"""The service that runs whole campaigns in worker processes and on clusters."""

import io
import json
import tarfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from threadpoolctl import threadpool_limits

from behavexplor.campaign.campaign import Campaign, ExecutionError
from behavexplor.campaign.config import CampaignConfig, campaign_config
from behavexplor.campaign.opening import opened
from behavexplor.campaign.record import DATABASE
from behavexplor.data.durable import folder_in
from behavexplor.data.target import Target
from behavexplor.errors import InputError
from behavexplor.execution.evaluator import evaluator_recipe
from behavexplor.execution.fingerprint import FINGERPRINT, machine_fingerprint
from behavexplor.execution.service import Recipe, Service
from behavexplor.execution.start import fewest_workers

RUN: Final = "run"  # name of the service's function
_PRELOAD: Final = ("behavexplor.bench.campaign_service", "behavexplor.envs.driving", "sklearn.cluster")


@dataclass(frozen=True)
class Outcome:
    """Outcome of a campaign.

    Attributes:
        finished: whether the campaign is complete.
        failure: sentence on why the campaign failed; None if it did not.
        warnings: warnings about the ADS, each of them a sentence.
    """

    finished: bool
    failure: str | None = None
    warnings: tuple[str, ...] = ()


class CampaignService(Service):
    """Runs one whole campaign for each call, and stops it on request."""

    def __init__(self) -> None:
        self.functions: Mapping[str, Callable[[bytes], bytes]] = {
            RUN: self.run,
            FINGERPRINT: lambda ads: machine_fingerprint(json.loads(ads)),
        }
        self._campaign: Campaign | None = None
        self._stopping = False

    def stop(self) -> None:
        """End the campaign after the current execution, or before the first one if it has not begun."""
        self._stopping = True
        if self._campaign is not None:
            self._campaign.stop()

    def run(self, request: bytes) -> bytes:
        """Run or resume a campaign.

        Returns:
            An `Outcome` as JSON and a newline, followed by the packed run folder if the request has no folder on this
            machine.
        """
        head, _, packed = request.partition(b"\n")
        values = json.loads(head)
        config, workers = campaign_config(values["config"]), values["workers"]
        if values["folder"] is not None:
            return _to_json(self.run_in(config, Path(values["folder"]), workers)) + b"\n"
        with TemporaryDirectory() as scratch:
            folder = Path(scratch) / "run"
            unpack(packed, folder)
            outcome = self.run_in(config, folder, workers)
            return _to_json(outcome) + b"\n" + pack(folder)

    def run_in(self, config: CampaignConfig, folder: Path, workers: int) -> Outcome:
        """Run or resume a campaign in a run folder.

        Args:
            config: configuration of the campaign.
            folder: the run folder.
            workers: number of processes that execute its scenarios; 0 is this process.
        """
        warnings: list[str] = []
        try:
            finished = self._run(config, folder, workers, warnings)
        except (InputError, ExecutionError) as error:
            return Outcome(finished=False, failure=str(error), warnings=tuple(warnings))
        return Outcome(finished, warnings=tuple(warnings))

    def _run(self, config: CampaignConfig, folder: Path, workers: int, warnings: list[str]) -> bool:
        workers = max(workers, fewest_workers(config.target))
        with opened(config, folder, workers, resume=(folder / DATABASE).is_file()) as ready:
            self._campaign = ready.campaign
            if self._stopping:
                ready.campaign.stop()
            warnings += ready.warnings
            threadpool_limits(1)  # includes libraries that the ADS has loaded
            ready.campaign.run(lambda _: None)
            ready.campaign.confirm()
            return not ready.campaign.stopping


def campaign_recipe(targets: Iterable[Target]) -> Recipe:
    """Return the recipe by which worker processes make the service. Each process runs a single campaign."""
    modules = dict.fromkeys(module for target in targets for module in evaluator_recipe(target).preload)
    name = f"{CampaignService.__module__}:{CampaignService.__qualname__}"
    return Recipe(name, preload=(*_PRELOAD, *modules), long_calls=True)


def campaign_request(config: CampaignConfig, folder: Path, workers: int, *, remote: bool) -> bytes:
    """Return the request for `CampaignService.run`.

    Args:
        config: configuration of the campaign.
        folder: its run folder on this machine.
        workers: number of processes that execute its scenarios; 0 is the campaign's own process.
        remote: whether the campaign may run on a machine without access to this folder. The contents of the folder are
            then part of the request.
    """
    place = None if remote else str(folder.resolve())
    head = {"config": {**asdict(config)}, "folder": place, "workers": workers}
    return json.dumps(head).encode() + b"\n" + (pack(folder) if remote else b"")


def take_outcome(answer: bytes, folder: Path) -> Outcome:
    """Return the outcome in an answer. If the answer has a packed run folder, write its files to the run folder."""
    head, _, packed = answer.partition(b"\n")
    if packed:
        unpack(packed, folder)
    values: dict[str, Any] = json.loads(head)
    return Outcome(values["finished"], values["failure"], tuple(values["warnings"]))


def pack(folder: Path) -> bytes:
    """Return the regular files of a run folder as a tar archive; empty if there is no such folder."""
    if not folder.is_dir():
        return b""
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w") as archive:
        for path in sorted(
            path for path in folder.rglob("*") if path.is_file() and not path.is_symlink() and path.suffix != ".lock"
        ):
            archive.add(path, path.relative_to(folder).as_posix(), recursive=False)
    return data.getvalue()


def unpack(packed: bytes, folder: Path) -> None:
    """Write the files of a packed run folder, each file atomically."""
    if not packed:
        return
    with TemporaryDirectory(dir=folder_in(folder.parent), prefix=".unpacking-") as scratch:
        with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
            archive.extractall(scratch, filter="data")
        for path in sorted(path for path in Path(scratch).rglob("*") if path.is_file()):
            inner = path.relative_to(scratch)
            path.replace(folder_in(folder, *inner.parts[:-1]) / inner.name)


def _to_json(outcome: Outcome) -> bytes:
    return json.dumps(asdict(outcome)).encode()
