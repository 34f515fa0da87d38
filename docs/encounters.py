"""Makes the figure of the search method `encounters` from executions: python docs/encounters.py."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from behavexplor.data.npc_motion import motion_on_route
from behavexplor.data.roadmap import RoadMap, Route
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.scripted_logical import require_scripted
from behavexplor.execution.simulation import Simulation
from behavexplor.fuzz.aiming import Aiming, AimingOptions, Drive
from behavexplor.fuzz.encounters import Encounters, EncountersOptions, Niche
from behavexplor.judge.specs import judge
from behavexplor.report.marks import page_colors

PICTURE = Path(__file__).parent / "encounters.png"
ENV, ADS, SEED, EXECUTIONS = "intersection-straight", "rule:apollo-like", 1, 300
NEAREST, SPACING = 8, 12  # niches in the figure: the nearest to a violation, and every twelfth of the others
SHIFT = 0.3  # added to degrees on the logarithmic axis

Floats = NDArray[np.float64]


class Aimed(NamedTuple):
    """A drive of the ego, and the vehicles of which one was aimed at it.

    Attributes:
        drive: drive of the ego on the empty road.
        poses: x, y and heading of the drawn vehicles at the times of the drive, shape (K, F, 3).
        chosen: index of the vehicle that was taken.
        reach: greatest distance at a meeting [m].
        roadmap: the roads.
    """

    drive: Drive
    poses: Floats
    chosen: int
    reach: float
    roadmap: RoadMap

    @property
    def distances(self) -> Floats:
        """Distance of every vehicle from the ego, shape (K, F) [m]."""
        return np.asarray(np.hypot(*np.moveaxis(self.poses[..., :2] - self.drive.pose[:, :2], -1, 0)))


def aimed(simulation: Simulation) -> Aimed:
    """Aim a vehicle at the ego's drive on the empty road."""
    logical = require_scripted(simulation.logical, "The figure")
    drive = Drive.of(simulation.run(ScriptedScenario(logical.name, ())))
    drawn: list[tuple[Floats, Floats]] = []

    def predict(roadmap: RoadMap, route: Route, waypoints: Floats, time: Floats) -> Floats:
        drawn.append((waypoints, motion_on_route(roadmap, route, waypoints, time)))
        return drawn[-1][1]

    options = AimingOptions(changing_share=0.0)
    npc = Aiming(logical, options, predict).aim(np.random.default_rng(SEED), drive, [])
    if npc is None:
        raise ValueError("No vehicle meets the ego: choose another seed")
    waypoints, poses = drawn[-1]
    wanted = np.array([(waypoint.position, waypoint.speed) for waypoint in npc.waypoints])
    chosen = int(np.flatnonzero((waypoints == wanted).all((1, 2)))[0])
    return Aimed(drive, poses, chosen, options.reach, logical.roadmap)


def searched(simulation: Simulation) -> dict[str, Niche]:
    """Niches of a campaign, the nearest to a violation first."""
    search = Encounters(simulation.logical, SEED, EncountersOptions())
    for _ in range(EXECUTIONS):
        candidate = search.ask()
        trace = simulation.run(candidate.scenario)
        search.tell(candidate, trace, judge(trace))
    return dict(sorted(search.niches.items(), key=lambda item: (item[1].elites[0].miss.degree, -item[1].failures)))


def figure(found: Aimed, niches: dict[str, Niche]) -> Figure:
    """Aimed vehicles from above and by their distance from the ego, and the niches of a campaign."""
    sheet = Figure(figsize=(10.0, 8.0), layout="constrained")
    above, below = sheet.subfigures(2, 1, height_ratios=[1.25, 1.0])
    roads, distances = above.subplots(1, 2)
    colors = {name: tuple(part / 255 for part in color) for name, color in page_colors().items()}
    _draw_roads(roads, found, colors)
    _draw_distances(distances, found, colors)
    _draw_niches(below.subplots(), niches, colors)
    return sheet


def _draw_roads(panel: Axes, found: Aimed, colors: dict[str, Any]) -> None:
    """The drive and the chosen vehicle from above, with dots every two seconds, and their meeting."""
    for route in found.roadmap.routes.values():
        panel.plot(*route.polyline(0.0, route.length).T, color=colors["road"], lw=9, solid_capstyle="butt", zorder=0)
    ego, other = found.drive.pose, found.poses[found.chosen]
    at = int(found.distances[found.chosen].argmin())
    for name, poses, color in (("ego, recorded", ego, colors["ego"]), ("aimed vehicle", other, colors["hit"])):
        panel.plot(*poses[: at + 1, :2].T, color=color, lw=1.5, label=name)
        panel.plot(*poses[at % 8 : at + 1 : 8, :2].T, ".", color=color, ms=7)
    time = found.drive.time[at]
    panel.plot(*ego[at, :2], "o", ms=18, mfc="none", mec=colors["accent"], label=f"meeting at {time:.1f} s")
    x, y = ego[at, :2]
    panel.set(xlim=(x - 40, x + 40), ylim=(y + 35, y - 35), aspect="equal", xticks=[], yticks=[])
    panel.set_title("The vehicle and the ego's recorded drive, a dot every 2 s", fontsize="medium")
    panel.legend(loc="lower left", fontsize="small")


def _draw_distances(panel: Axes, found: Aimed, colors: dict[str, Any]) -> None:
    """The distance of every drawn vehicle from the ego."""
    for row in found.distances:
        panel.plot(found.drive.time, row, color=colors["v5"], lw=0.6)
    panel.plot(found.drive.time, found.distances[found.chosen], color=colors["hit"], lw=2, label="the one taken")
    panel.axhline(found.reach, color=colors["accent"], ls="--", lw=1, label=f"{found.reach} m")
    panel.set(xlabel="time [s]", ylabel="distance from the ego [m]", ylim=(0, 60))
    panel.set_title(
        f"{len(found.poses)} vehicles drawn on its route; one that meets the ego is taken", fontsize="medium"
    )
    panel.legend(loc="upper right", fontsize="small")


def _draw_niches(panel: Axes, niches: dict[str, Niche], colors: dict[str, Any]) -> None:
    """The kept near misses of some niches: those nearest to a violation, and some of the others."""
    names = [*list(niches)[:NEAREST], *list(niches)[NEAREST::SPACING]]
    for row, name in enumerate(names):
        niche = niches[name]
        degrees = np.array([elite.miss.degree for elite in niche.elites])
        failed = niche.failures > 0
        panel.plot(degrees + SHIFT, np.full(len(degrees), row), "o", color=colors["hit" if failed else "accent"])
        if failed:
            words = f"failures: {niche.failures}"
            panel.annotate(words, (0.99, row), xycoords=("axes fraction", "data"), ha="right", va="center")
    ticks = (0, 1, 3, 10, 30)
    panel.set(xscale="log", xlim=(SHIFT * 0.9, 60), yticks=range(len(names)), yticklabels=names)
    panel.set_xticks([tick + SHIFT for tick in ticks], [str(tick) for tick in ticks])
    panel.minorticks_off()
    panel.invert_yaxis()
    panel.set_xlabel("degrees of the kept near misses; 0 is a violation")
    panel.set_title(f"{len(names)} of the {len(niches)} niches after {EXECUTIONS} executions", fontsize="medium")


def main() -> None:
    """Draw the figure."""
    simulation = Simulation(ENV, ADS)
    found, niches = aimed(simulation), searched(simulation)
    simulation.close()
    figure(found, niches).savefig(PICTURE, dpi=110, metadata={"Software": ""})
    for name, niche in niches.items():
        print(f"{niche.elites[0].miss.degree:7.2f} {niche.failures:3} {name}")


if __name__ == "__main__":
    main()
