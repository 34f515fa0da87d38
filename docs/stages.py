"""Makes the figure of where the time of campaigns goes, from measured figures: python docs/stages.py."""

import json
from pathlib import Path

from matplotlib.figure import Figure

from behavexplor.campaign.stage_clock import STAGES

FIGURES = Path(__file__).parent / "data" / "performance.json"
PICTURE = Path(__file__).parent / "stages.png"
COLORS = ("#8a9199", "#e69f00", "#0b5c99", "#dcdfe3", "#009e73", "#cc79a7", "#1c1f23")  # those of the report


def main() -> None:
    """Draw one bar for each measured campaign, with the time in each stage."""
    rows = json.loads(FIGURES.read_text())["stages"]
    figure = Figure(figsize=(9, 0.55 * len(rows) + 1.2), layout="constrained")
    axes = figure.subplots()
    names = [f"{row['driver']}, {row['workers'] or 'no'} workers" for row in rows]
    before = [0.0] * len(rows)
    for stage, color in zip(STAGES, COLORS, strict=True):
        seconds = [row.get(stage, 0.0) for row in rows]
        axes.barh(names, seconds, left=before, color=color, label=stage, height=0.6)
        before = [start + more for start, more in zip(before, seconds, strict=True)]
    axes.invert_yaxis()
    axes.set_xlabel("seconds of the campaign's own process")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=len(STAGES), frameon=False)
    figure.savefig(PICTURE, dpi=120)


if __name__ == "__main__":
    main()
