"""Makes the figure of where the time of campaigns goes, from measured figures: python docs/stages.py."""

import json
from pathlib import Path

from matplotlib.figure import Figure

from behavexplor.campaign.progress import STAGES
from behavexplor.report.marks import page_colors

FIGURES = Path(__file__).parent / "data" / "performance.json"
PICTURE = Path(__file__).parent / "stages.png"
COLORS = ("v5", "v1", "accent", "rule", "v2", "v3", "ink")  # those of the bar in a report (.g0 to .g6 in page.css)


def main() -> None:
    """Draw one bar for each measured campaign, with the time in each stage."""
    rows = json.loads(FIGURES.read_text())["stages"]
    figure = Figure(figsize=(9, 0.55 * len(rows) + 1.2), layout="constrained")
    axes = figure.subplots()
    names = [f"{row['driver']}, {row['workers'] or 'no'} workers" for row in rows]
    before = [0.0] * len(rows)
    colors = [tuple(part / 255 for part in page_colors()[name]) for name in COLORS]
    for stage, color in zip(STAGES, colors, strict=True):
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
