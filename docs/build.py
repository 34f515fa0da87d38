"""Makes the environments' pages from their docstrings: python docs/build.py [--pictures] [--notebooks].

With --pictures also their pictures; with --notebooks, what the notebooks in docs/notebooks show.
"""

import inspect
import os
import sys
import tempfile
from pathlib import Path

import gymnasium
import nbformat
from nbclient import NotebookClient
from PIL import Image

import behavexplor
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scripted_logical import ScriptedLogicalScenario

FOLDER = Path(__file__).parent / "environments"
NOTEBOOKS = sorted((Path(__file__).parent / "notebooks").glob("*.ipynb"))
SEED = 4  # of the scenario in the pictures
VIEWS = {"intersection": (900, 900, 4.4, [0.5, 0.88]), "lane": (1500, 260, 5.6, [0.05, 0.5])}  # size, scale, center
OTHER_VIEW = (900, 900, 3.0, [0.5, 0.5])


def facts(logical: ScriptedLogicalScenario) -> str:
    """What can be read from a logical scenario, as a table."""
    roadmap = logical.roadmap
    lanes = " or ".join(str(count) for count in sorted({len(route.lanes) for route in roadmap.npc_routes}))
    rows = {
        "ego's way": way(roadmap),
        "NPCs": f"{logical.n_npcs}, each on one of {len(roadmap.npc_routes)} routes",
        "waypoints": f"{logical.waypoints_per_lane} on each of a route's {lanes} lanes",
        "illegal lines": " and ".join(
            f"{kind.replace('-', ' ')} lines" for kind in sorted(set(roadmap.line_kinds))[::-1]
        ),
        "speed limit": f"{roadmap.speed_limit:g} m/s",
    }
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows.items())])


def way(roadmap: RoadMap) -> str:
    """How far the ego goes, and with which turns and lane changes."""
    parts = [f"{roadmap.destination - roadmap.ego_start:.0f} m"]
    for lane in roadmap.ego_route.lanes:
        if lane.curvature:
            side = "right" if lane.curvature > 0 else "left"
            parts.append(f"with a turn to the {side} of {1 / abs(lane.curvature):g} m radius")
    if roadmap.ego_offset:
        side = "right" if roadmap.ego_offset < 0 else "left"
        lanes = abs(roadmap.ego_offset) / roadmap.ego_route.lanes[0].width
        parts.append(f"with a change of {lanes:g} lanes to the {side}")
    return ", ".join(parts)


def page(name: str) -> str:
    """The page of an environment: what is special to it, then what all share."""
    env = type(gymnasium.make(f"{behavexplor.NAMESPACE}/{name}-v0").unwrapped)
    special, version = (inspect.cleandoc(env.__doc__ or "") + "\n").split("## Version history")
    shared = (
        inspect.cleandoc(env.__mro__[1].__doc__ or "").partition("## Concrete scenarios")[2].partition("Raises:")[0]
    )
    special += facts(env.logical)
    text = (
        f"# {behavexplor.NAMESPACE}/{name}-v0\n\n{special}\n\n## Concrete scenarios{shared}## Version history{version}"
    )
    return "<!-- made from the docstrings by docs/build.py -->\n\n" + text.strip() + "\n"


def picture(name: str) -> Image.Image:
    """A sampled scenario at its start, the NPCs' routes drawn."""
    width, height, scaling, center = VIEWS.get(name.partition("-")[0], OTHER_VIEW)
    config = {"screen_width": width, "screen_height": height, "scaling": scaling, "centering_position": center}
    env = gymnasium.make(f"{behavexplor.NAMESPACE}/{name}-v0", config=config, render_mode="rgb_array")
    env.reset(seed=SEED)
    image = Image.fromarray(env.render())
    env.close()
    return image


def shown(path: Path, folder: str | Path) -> nbformat.NotebookNode:
    """A notebook with what its cells return when it runs in a folder, but without progress, which has running times."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(folder)}})
    client.execute(env={**os.environ, "PYTHONPATH": str(Path(__file__).parent.parent)})
    for cell in notebook.cells:
        cell.metadata = {}
        if cell.cell_type == "code":
            cell.outputs = [one for one in cell.outputs if one.output_type == "execute_result"]
            for one in cell.outputs:
                one.data.pop("image/jpeg", None)  # a picture is kept once, as PNG
    notebook.metadata.language_info = {"name": "python"}
    return notebook


def main() -> None:
    """Write all pages, and the pictures if asked to."""
    for name in behavexplor.FUNCTIONAL_SCENARIOS:
        (FOLDER / f"{name}.md").write_text(page(name))
        if "--pictures" in sys.argv[1:]:
            picture(name).save(FOLDER / f"{name}.png", optimize=True)
    if "--notebooks" in sys.argv[1:]:
        for path in NOTEBOOKS:
            with tempfile.TemporaryDirectory() as folder:
                nbformat.write(shown(path, folder), path)


if __name__ == "__main__":
    main()
