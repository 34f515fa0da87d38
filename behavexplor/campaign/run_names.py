"""Names of folders for results that were given no name."""

import re
import time
from pathlib import Path
from typing import Final

from behavexplor.campaign.config import CampaignConfig

RUNS: Final = Path("runs")  # their parent folder


def run_folder(config: CampaignConfig, root: Path = RUNS) -> Path:
    """Return an unused folder for a campaign, named after its configuration and the current time."""
    names = [
        re.sub(r"[^\w.-]", "-", name.rstrip("/").rsplit("/", 1)[-1]) for name in (config.env, config.ads, config.method)
    ]
    return stamped_folder("-".join([*names, str(config.seed)]), root)


def stamped_folder(name: str, root: Path = RUNS) -> Path:
    """Return an unused folder that is named after its contents and the current time."""
    stamped = f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
    taken = sum(1 for _ in root.glob(f"{stamped}*"))
    return root / (f"{stamped}-{taken + 1}" if taken else stamped)
