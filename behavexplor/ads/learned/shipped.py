"""Trained policies that come with this package, with one file of weights and one card each."""

from pathlib import Path

from behavexplor.ads.learned.driver import LearnedDriver, read_layers
from behavexplor.data.roadmap import RoadMap
from behavexplor.errors import unknown_name

FOLDER = Path(__file__).parent / "policies"


def learned_driver(roadmap: RoadMap, variant: str = "") -> LearnedDriver:
    """Load a policy that comes with this package.

    Args:
        roadmap: road map with the ego's route.
        variant: name of the policy, such as "lane-change" or "lane-change-undertrained".

    Raises:
        InputError: if no policy has that name.
    """
    names = [path.stem for path in sorted(FOLDER.glob("*.npz"))]
    if variant not in names:
        raise unknown_name("policy, as in learned:NAME,", variant, names)
    return LearnedDriver(roadmap, read_layers(FOLDER / f"{variant}.npz"))
