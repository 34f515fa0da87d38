"""Trained policies that come with this package, with one file of weights and one card each."""

from pathlib import Path

from behavexplor.ads.learned.driver import LearnedDriver
from behavexplor.ads.learned.network_file import read_network
from behavexplor.data.roadmap import RoadMap
from behavexplor.errors import unknown_name

PREFIX = "learned:"
FOLDER = Path(__file__).parent / "policies"


def learned_driver(roadmap: RoadMap, variant: str = "") -> LearnedDriver:
    """Load a policy that comes with this package, such as "lane-change" or "lane-change-undertrained".

    Raises:
        InputError: if no policy has that name.
    """
    return LearnedDriver(roadmap, read_network(policy_file(f"{PREFIX}{variant}")))


def policy_file(name: str) -> Path:
    """Return the file of a policy's network: "learned:NAME" for one that comes with this package, or a path.

    Raises:
        InputError: if "learned:NAME" has an unknown name. Whether a path exists is not checked.
    """
    if not name.startswith(PREFIX):
        return Path(name)
    variant = name.removeprefix(PREFIX)
    names = [path.stem for path in sorted(FOLDER.glob("*.npz"))]
    if variant not in names:
        raise unknown_name("policy, as in learned:NAME,", variant, names)
    return FOLDER / f"{variant}.npz"
