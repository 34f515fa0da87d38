"""Layout of the bar that shows where the time of a run went; see `behavexplor.campaign.stage_clock`."""

from collections.abc import Mapping
from dataclasses import dataclass

from behavexplor.campaign.stage_clock import STAGES


@dataclass(frozen=True)
class StagePart:
    """The part of a bar that stands for one stage.

    Attributes:
        name: name of the stage.
        words: what the campaign does in it.
        seconds: time in the stage [s].
        begin: where the part begins, in percent of the bar.
        share: length of the part, in percent of the bar.
        style: index of a style of the page.
    """

    name: str
    words: str
    seconds: float
    begin: float
    share: float
    style: int


def stage_parts(stages: Mapping[str, float]) -> tuple[StagePart, ...]:
    """Return the parts of a bar, in the order of the stages, without stages that took no time.

    Args:
        stages: time in each stage [s]; empty if it is not known.
    """
    total = sum(stages.values())
    parts, before = [], 0.0
    for style, (name, words) in enumerate(STAGES.items()):
        seconds = stages.get(name, 0.0)
        if seconds > 0:
            parts.append(
                StagePart(name, words, seconds, round(100 * before / total, 2), round(100 * seconds / total, 2), style)
            )
        before += seconds
    return tuple(parts)
