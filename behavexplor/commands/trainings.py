"""What the commands that train have in common: the folder of a training, and how its progress is said."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from behavexplor.campaign.config import read_yaml
from behavexplor.data.durable import make_folder, write_durably, writing
from behavexplor.data.validation import checked
from behavexplor.errors import InputError

if TYPE_CHECKING:
    from behavexplor.repair.retraining_rounds import RetrainingConfig
    from behavexplor.training import Learned, TrainingConfig

_Config = TypeVar("_Config")


def resumed_config(kind: type[_Config], file: Path, what: str) -> _Config:
    """Return the configuration in the folder of a training that is resumed; `what` names it in messages.

    Raises:
        InputError: if the folder has no such file, or the file cannot be used.
    """
    if not file.is_file():
        raise InputError(f"{file.parent} is not the folder of a {what}: it has no {file.name}")
    values = read_yaml(file)
    if not values:
        raise InputError(f"{file} is empty, so the configuration of the {what} is lost: restore it or start a new one")
    return checked(kind, values, what)


def begin_training(folder: Path, name: str, config: "TrainingConfig | RetrainingConfig") -> None:
    """Create the folder of a training with its configuration.

    Raises:
        InputError: if the folder is not empty, or cannot be written.
    """
    with writing(f"The folder {folder}"):
        if any(make_folder(folder).iterdir()):
            again = f"--resume {shlex.quote(str(folder))}"
            raise InputError(f"{folder} is not empty: resume with {again}, or choose another --out")
        write_durably(folder / name, config.to_yaml())


def progress_line(learned: "Learned") -> str:
    """Return the progress of a training in words."""
    ends = ", ".join(f"{end} {share:.0%}" for end, share in sorted(learned.ends.items(), key=lambda end: -end[1]))
    return f"reward {learned.reward:6.2f}, {ends}"
