"""`behavexplor export`: write executions as files that other tools can play."""

import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from itertools import chain, count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Final, Literal

import tyro

from behavexplor.campaign.config import CampaignConfig, stored_config
from behavexplor.campaign.folder_format import CONFIG
from behavexplor.campaign.provenance import ADS, DRIVING, Consent, accepted
from behavexplor.campaign.store import Execution, Store
from behavexplor.commands import OK
from behavexplor.commands.roads import check_libraries, road_of
from behavexplor.commands.shared_flags import NewFolder, RunFolder, Trust
from behavexplor.commands.wording import counted, say, wrapped
from behavexplor.data.conventions import EPISODE_TIME
from behavexplor.data.durable import make_folder, writing
from behavexplor.data.road_plan import RoadPlan
from behavexplor.errors import InputError
from behavexplor.exchange.scenes import SceneFile, movers_of, write_table
from behavexplor.report.marks import outcome


def export(
    run: RunFolder,
    numbers: Annotated[
        tuple[int, ...], tyro.conf.Positional, tyro.conf.arg(name="ids", metavar="[ID ...]", help_behavior_hint="")
    ] = (),
    *,
    out: NewFolder,
    format: Literal["openscenario", "openscenario-1.0", "csv"] = "openscenario",  # noqa: A002 - the flag's name
    ego: Literal["recorded", "free"] = "recorded",
    npcs: Annotated[Literal["trajectories", "routes"], tyro.conf.arg(help_behavior_hint="(default: trajectories)")] = (
        "trajectories"
    ),
    trust: Trust = (),
) -> int:
    """Write executions of a run as files that other tools can play (docs/exchange.md).

    The formats are OpenSCENARIO XML 1.2, or 1.0 for CARLA's ScenarioRunner, with the road as OpenDRIVE, and CSV tables.

    Args:
        run: The run folder.
        numbers: Numbers of the executions, as in `records`; by default all failures.
        out: Folder for the files. Those that are there are kept.
        format: Format of the files.
        ego: The ego as it was recorded, or free, for the driver of the other tool: only its start and destination.
        npcs: Scripted vehicles as trajectories, or as routes with speed profiles.
        trust: Allow the folder with this digest ("sha256:...") to execute code: that of its environment.
    """
    if format != "csv":
        check_libraries()
    elif (ego, npcs) != ("recorded", "trajectories"):
        raise InputError("--ego and --npcs cannot be given with --format csv: a table has what was recorded")
    for_carla = format == "openscenario-1.0"
    routes = npcs == "routes"
    if for_carla and routes:
        raise InputError("--npcs routes cannot be given with --format openscenario-1.0, which has no speed profiles")
    with closing(Store.read(run)) as store, writing(f"The folder {out}"):
        chosen = tuple(dict.fromkeys(numbers)) or tuple(record.id for record in store.records() if record.failed)
        config = stored_config(run).unverified
        if format != "csv":  # the environment is made for its road; nothing is driven
            config = accepted(stored_config(run), Consent(trust), DRIVING - {ADS})
        with _new_files(out) as draft:
            scenes = _Scenes(run, config, draft, out, is_ego_free=ego == "free", as_routes=routes, for_carla=for_carla)
            for execution in map(store.execution, chosen):
                if format == "csv":
                    write_table(execution.scenario, execution.load_trace(), draft / f"{execution.id:06d}.csv")
                else:
                    scenes.write(execution)
    say(f"{counted(len(chosen), 'execution')} written to {out}")
    if scenes.motionless:
        say(wrapped(f"{scenes.motionless} of these {_AT_ONCE}"))
    return OK


@contextmanager
def _new_files(out: Path) -> Iterator[Path]:
    """Yield an empty folder. Its files are moved to `out` in the end, unless one would replace a different file."""
    with TemporaryDirectory(prefix=".export-", dir=make_folder(out)) as folder:
        yield Path(folder)
        files = {file: out / file.name for file in sorted(Path(folder).iterdir())}
        for file, there in files.items():
            if there.exists() and there.read_bytes() != file.read_bytes():
                raise InputError(
                    f"{there} is kept, and another file would take its place: name another folder for --out"
                )
        for file, there in files.items():
            file.replace(there)


_AT_ONCE: Final = f"ended in the first frame: nothing moves as recorded until the time limit of {EPISODE_TIME:g} s"
_EARLY: Final = "; highway-env may declare it before the boxes touch, and then the time limit stops the scene"


class _Scenes:
    """The scenes of an export, in `draft`, which the command moves to `out`. Those on the same road share its file."""

    def __init__(
        self,
        run: Path,
        config: CampaignConfig,
        draft: Path,
        out: Path,
        *,
        is_ego_free: bool,
        as_routes: bool,
        for_carla: bool,
    ) -> None:
        self._config = config
        self._date = datetime.fromtimestamp(int((run / CONFIG).stat().st_mtime), UTC)
        self._draft, self._out = draft, out
        self._is_ego_free = is_ego_free
        self._as_routes = as_routes
        self._for_carla = for_carla
        self._roads: dict[RoadPlan, str] = {}
        self.motionless = 0  # number of scenes without recorded motion

    def write(self, execution: Execution) -> None:
        """Write an execution."""
        from behavexplor.exchange.openscenario import CARLA, STANDARD, write_scene  # noqa: PLC0415 - needs the extra `scenes`

        scenario, trace = execution.scenario, execution.load_trace()
        plan, logical = road_of(scenario, self._config.env, self._config.env_config or {})
        is_reactive = logical.has_original  # one of highway-env's own environments, whose vehicles react to the ego
        if self._is_ego_free and is_reactive:
            raise InputError(
                f"The vehicles of {self._config.env} react to the ego, and a scene has only what they did with the "
                "recorded one: --ego free is for the environments with scripted vehicles"
            )
        record = execution.record
        goes_on = trace.duration == 0 or self._is_ego_free
        early = _EARLY if is_reactive and record.end == "collision" else ""
        ended = outcome(record.violated, record.end)
        is_motionless = trace.duration == 0 and not self._is_ego_free
        self.motionless += is_motionless
        at_once = f"; it {_AT_ONCE}" if is_motionless else ""
        scene = SceneFile(
            title=f"Execution {execution.id} of {self._config.env}: it {ended}{at_once}{early}",
            environment=self._config.env,
            env_config={} if is_reactive else self._config.env_config or {},
            road_file=self._road_file(plan, execution.id),
            movers=movers_of(scenario, trace, logical, is_ego_free=self._is_ego_free),
            is_ego_free=self._is_ego_free,
            destination=trace.destination,
            stops_there=not is_reactive,
            time_limit=EPISODE_TIME if goes_on else trace.duration,
            scenario=scenario if is_reactive else None,
        )
        if self._for_carla and any(mover.is_gone or mover.time[0] > 0 for mover in scene.movers):
            raise InputError(
                f"In execution {execution.id}, a vehicle appears or leaves, which CARLA's ScenarioRunner cannot play: "
                "give the numbers of other executions"
            )
        path = self._draft / f"{execution.id:06d}.xosc"
        write_scene(scene, path, self._date, as_routes=self._as_routes, dialect=CARLA if self._for_carla else STANDARD)

    def _road_file(self, plan: RoadPlan, number: int) -> str:
        """Return the name of the file of a road, which is written if it is new."""
        from behavexplor.exchange.opendrive import write_road  # noqa: PLC0415 - needs the extra `scenes`
        from behavexplor.exchange.xml_files import same_road  # noqa: PLC0415

        if plan not in self._roads:
            name = re.sub(r"[^\w.-]", "-", self._config.env.rpartition("/")[2])
            road, own = self._draft / "road", f"{name}-{number:06d}"
            write_road(plan, name, road)
            stems = chain([name, own], (f"{own}-{i}" for i in count(2)))  # a file with another road is passed over
            for file in (f"{stem}.xodr" for stem in stems):
                there = self._out / file
                if file not in self._roads.values() and (not there.exists() or same_road(there, road)):
                    break
            if there.exists():  # with the same road
                road.unlink()
            else:
                road.replace(self._draft / file)
            self._roads[plan] = file
        return self._roads[plan]
