"""Zip files saved by Stable-Baselines3: read without executing anything, and checked for suspicious pickles."""

import base64
import binascii
import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final
from zipfile import ZipFile

from behavexplor.ads.sb3.inert import read_pickle
from behavexplor.errors import InputError

MAX_BYTES: Final = 2_000_000_000  # greatest size of an unpacked file
MAX_RATIO: Final = 200  # greatest ratio of unpacked to packed size

DATA, WEIGHTS = "data", "policy.pth"
SETTINGS = ("policy_class", "policy_kwargs", "observation_space", "action_space", "use_sde", "_last_obs")

# Names that pickles in a saved model ordinarily contain.
_ORDINARY: Final = re.compile(
    r"(stable_baselines3|sb3_contrib|gymnasium\.spaces|gym\.spaces|numpy\.(_?core|random|dtype|ndarray))\b"
    r"|torch\.(_utils|nn\.modules|optim|device|Size|\w*Storage)\b|(abc|collections|copyreg|types|typing|__main__)\."
    r"|cloudpickle\.cloudpickle\._|_codecs\.encode$"
    r"|builtins\.(bytearray|bytes|dict|float|frozenset|int|list|object|property|range|set|slice|str|tuple|type)$"
)


@dataclass(frozen=True)
class Archive:
    """The contents of a model's file.

    Attributes:
        path: path of the file.
        digest: digest of the whole file, "sha256:...".
        settings: entries of `SETTINGS` that the file contains, as `behavexplor.ads.sb3.inert` reads them.
        weights: contents of the member `policy.pth`.
        suspicions: calls that loading the file with Stable-Baselines3 would make and that models do not need, each as
            a phrase that names the place.
    """

    path: Path
    digest: str
    settings: Mapping[str, Any]
    weights: bytes
    suspicions: tuple[str, ...]


def read_archive(path: Path) -> Archive:
    """Read a model's file.

    Raises:
        InputError: if the file was not saved by Stable-Baselines3, is damaged, or unpacks to too many bytes.
    """
    try:
        packed = path.read_bytes()
        with ZipFile(path) as file:
            _check_members(path, file, len(packed))
            data = json.loads(file.read(DATA))
            suspicions = (*_of_data(data), *_of_tensors(file))
            weights = file.read(WEIGHTS)
    except InputError:
        raise
    except Exception as error:  # zipfile, zlib and json raise many kinds of errors for damaged files
        raise InputError(f"{path} is not a zip file of Stable-Baselines3, or is damaged: {error}") from None
    try:
        settings = {key: _plain(data[key]) for key in SETTINGS if key in data}
    except ValueError as error:
        raise InputError(f"The data of {path} cannot be read: {error}") from None
    digest = f"sha256:{hashlib.sha256(packed).hexdigest()}"
    return Archive(path, digest, MappingProxyType(settings), weights, suspicions)


def suspicious_names(names: frozenset[str]) -> list[str]:
    """Return the sorted names of a pickle that saved models do not ordinarily contain."""
    return sorted(name for name in names if not _ORDINARY.match(name))


def _check_members(path: Path, file: ZipFile, packed: int) -> None:
    """Check the members of a zip file before anything is unpacked."""
    if missing := {DATA, WEIGHTS} - set(file.namelist()):
        raise InputError(f"{path} is not a model of Stable-Baselines3: it has no {', '.join(sorted(missing))}")
    unpacked = sum(member.file_size for member in file.infolist())
    if unpacked > min(MAX_BYTES, MAX_RATIO * packed):
        raise InputError(f"{path} would unpack to {unpacked} bytes, which no model needs; it was not read")


def _plain(value: Any) -> Any:
    """Return a setting as it stands in the JSON, or the contents of its pickle."""
    if isinstance(value, dict) and ":serialized:" in value:
        return read_pickle(_decoded(value))[0]
    return value


def _decoded(value: Mapping[str, Any]) -> bytes:
    try:
        return base64.b64decode(str(value[":serialized:"]), validate=True)
    except binascii.Error as error:
        raise ValueError(f"base64 is damaged: {error}") from None


def _of_data(data: Any) -> Iterator[str]:
    if not isinstance(data, dict):
        raise ValueError("its data is not a JSON object")  # noqa: TRY004 - it comes from a file
    for key, value in data.items():
        if isinstance(value, dict) and ":serialized:" in value:
            yield from _of_pickle(f"{key!r} of its data", _decoded(value))


def _of_tensors(file: ZipFile) -> Iterator[str]:
    """Yield the suspicions about the tensor files of an archive: zip files that contain a pickle."""
    for name in file.namelist():
        if not name.endswith(".pth"):
            continue
        with file.open(name) as member, ZipFile(member) as tensors:
            for part in tensors.namelist():
                if part.endswith(".pkl"):
                    yield from _of_pickle(name, tensors.read(part))


def _of_pickle(place: str, data: bytes) -> Iterator[str]:
    try:
        _, names = read_pickle(data)
    except ValueError:
        yield f"{place} is not a readable pickle ({len(data)} bytes)"
        return
    for name in suspicious_names(names):
        yield f"{place} calls {name}"
