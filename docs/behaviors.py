"""Makes the figure of the paper's scenarios A, B and C from executions: python docs/behaviors.py."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from behavexplor.behavior.features import TIME_STEP, Labels
from behavexplor.behavior.miner import BehaviorMiner, MinerOptions
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.execution.simulation import Simulation

PICTURE = Path(__file__).parent / "behaviors.png"
ENV, ADS = "lane-follow", "rule:hardened"
PAIRS = ("AB", "BC", "AC")
TITLES = {"A": "A: follows a slow vehicle", "B": "B: drives on", "C": "C: bypasses a slow vehicle"}
BESIDE = [("lane-2", 30.0), ("lane-2", 42.0), ("lane-4", 30.0), ("lane-4", 42.0)]  # vehicles that keep the ego behind
VEHICLES = {  # route, start [m] and speed [m/s]; the ego drives on lane-3
    "A": [("lane-3", 40.0, 4.0), *((route, start, 4.0) for route, start in BESIDE)],
    "B": [],
    "C": [("lane-3", 45.0, 3.0)],
}


class Abstracted(NamedTuple):
    """Abstract traces of the scenarios, and their distances.

    Attributes:
        labels: abstract trace by scenario.
        distances: distance by pair of scenarios, such as "AB".
    """

    labels: dict[str, Labels]
    distances: dict[str, float]


def scenario(vehicles: list[tuple[str, float, float]], logical: ScriptedLogicalScenario) -> ScriptedScenario:
    """A scenario of sedans that drive steadily and park at the end of their routes."""
    return ScriptedScenario(logical.name, tuple(_steady(logical, *vehicle) for vehicle in vehicles))


def _steady(logical: ScriptedLogicalScenario, route: str, start: float, speed: float) -> NPC:
    first, last = np.split(logical.position_ranges(logical.roadmap.routes[route]), 2)
    positions = [*np.linspace(start, first[0, 1], len(first)), *np.linspace(*last[0], len(last))]
    speeds = [speed] * (len(positions) - 1) + [0.0]
    return NPC("sedan", route, tuple(map(Waypoint, map(float, positions), speeds)))


def executed() -> dict[str, Trace]:
    """The traces of the scenarios by name."""
    simulation = Simulation(ENV, ADS)
    traces = {name: simulation.run(scenario(found, simulation.logical)) for name, found in VEHICLES.items()}
    simulation.close()
    return traces


def abstracted(traces: dict[str, Trace], options: MinerOptions) -> Abstracted:
    """Abstract traces with clusters fitted to the traces themselves, and compute their distances."""
    miner = BehaviorMiner(options)
    described = {name: miner.describe(trace) for name, trace in traces.items()}
    index = {name: miner.add(behavior) for name, behavior in described.items()}
    miner.fit()
    labels = {name: miner.abstract(behavior) for name, behavior in described.items()}
    distances = {pair: float(miner.distances(labels[pair[0]])[index[pair[1]]]) for pair in PAIRS}
    return Abstracted(labels, distances)


def figure(traces: dict[str, Trace], found: Abstracted) -> Figure:
    """Speeds over time, on a ground of abstract states."""
    sheet = Figure(figsize=(8.0, 4.6), layout="constrained")
    panels = sheet.subplots(3, 1, sharex=True)
    colors = ListedColormap([f"C{i}" for i in range(10)])
    for panel, (name, trace) in zip(panels, traces.items(), strict=True):
        labels = found.labels[name]
        extent = (0.0, len(labels) * TIME_STEP, 0.0, 12.0)
        panel.imshow(labels[None], aspect="auto", extent=extent, cmap=colors, vmin=-0.5, vmax=9.5, alpha=0.55)
        panel.plot(trace.time, np.hypot(*trace.velocity[:, 0].T), color="black", lw=1.2)
        panel.set(ylabel="speed [m/s]", title=f"{TITLES[name]}, {trace.duration:.1f} s", xlim=(0, 50))
    panels[-1].set_xlabel("time [s]; colors are abstract states")
    words = ", ".join(f"{a} and {b} {found.distances[a + b]:.2f}" for a, b in PAIRS)
    sheet.suptitle(f"Distances: {words}", fontsize="medium")
    return sheet


def main() -> None:
    """Draw the figure, and print the distances with and without scaling, over 20 random states of K-means."""
    traces = executed()
    figure(traces, abstracted(traces, MinerOptions())).savefig(PICTURE, dpi=110, metadata={"Software": ""})
    for scaling in ("zscore", "none"):
        found = [abstracted(traces, MinerOptions(scaling=scaling, random_state=i)).distances for i in range(20)]
        for pair in PAIRS:
            values = [distances[pair] for distances in found]
            print(f"{scaling} {pair}: {values[0]:.2f}, {min(values):.2f} to {max(values):.2f}")


if __name__ == "__main__":
    main()
