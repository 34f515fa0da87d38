"""Zip files saved by Stable-Baselines3: read without executing anything, and checked for suspicious pickles."""

import base64
import binascii
import hashlib
import io
import json
import pickle
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final
from zipfile import ZipFile

from behavexplor.ads.sb3.inert import LOAD_TENSOR, OLD_TORCH, PickleReader, TooLongError, check_extent
from behavexplor.data.untrusted import member, read_file, unpacked_size
from behavexplor.errors import InputError

MAX_BYTES: Final = 1_000_000_000  # greatest size of a file, packed or unpacked
MAX_DATA: Final = 50_000_000  # greatest size of its settings
MAX_RATIO: Final = 20  # greatest ratio of unpacked to packed size of a large file; Stable-Baselines3 does not compress
LARGE: Final = 10_000_000
MAX_ABOUT: Final = 10_000  # characters of `system_info.txt` that are read

SAVE_WEIGHTS: Final = "save its weights by torch.save(model.state_dict(), 'weights.pth')"
DATA, WEIGHTS, OPTIMIZER, SYSTEM = "data", "policy.pth", "policy.optimizer.pth", "system_info.txt"
SETTINGS = ("policy_class", "policy_kwargs", "observation_space", "action_space", "use_sde", "_last_obs", "train_freq")

_PYTHON: Final = re.compile(r"Python: (3\.\d+)")
_VERSIONS: Final = re.compile(r"(Python|Stable-Baselines3|PyTorch|Gymnasium|OpenAI Gym|Gym): (\d[\w.+-]{0,30})")
# Names that pickles in a saved model ordinarily contain.
_ORDINARY: Final = re.compile(
    r"(stable_baselines3|sb3_contrib|gymnasium\.spaces|gym\.spaces|numpy\.(_?core|random|dtype|ndarray))\b"
    r"|torch\.(_utils|nn\.modules|optim|device|Size|\w*Storage)\b"
    r"|(abc|collections|copyreg|copy_reg|types|typing|__main__)\."
    r"|cloudpickle\.cloudpickle(_fast)?\._|_codecs\.encode$"
    r"|cloudpickle\.cloudpickle\.subimport($|\((math|numpy|torch)\)$)"
    r"|(builtins|__builtin__)\."
    r"(bool|bytearray|bytes|dict|float|frozenset|int|list|object|property|range|set|slice|str|tuple|type)$"
)
# Names of a pickle that is a tensor. None of them calls what it is given, so all that `LOAD_TENSOR` reads is known.
_OF_TENSOR: Final = re.compile(
    rf"({re.escape(LOAD_TENSOR)}|torch\._utils\._rebuild_tensor_v2|torch\.(storage\.)?[A-Za-z]*Storage"
    r"|collections\.OrderedDict)"
)
# How files begin that torch wrote before version 1.6: a pickle of this number, or the name of a tar archive's member.
_OLD_TORCH: Final = (OLD_TORCH, b"sys_info", b"storages", b"tensors", b"pickle")


@dataclass(frozen=True)
class Archive:
    """The contents of a model's file."""

    path: Path  # path of the file
    packed: bytes = field(repr=False)  # the whole file
    digest: str  # digest of the whole file, "sha256:..."
    # entries of `SETTINGS` that the file contains, as `behavexplor.ads.sb3.inert` reads them
    settings: Mapping[str, Any]
    # all settings that are a number, such as the hyperparameters of the training
    numbers: Mapping[str, int | float | bool]
    weights: bytes  # contents of the member `policy.pth`
    optimizer: bytes | None  # contents of the member `policy.optimizer.pth`; None if there is none
    python: str  # version of Python that wrote the file, such as "3.10"; empty if the file does not say so
    versions: tuple[str, ...]  # those of Python and of the libraries that wrote it, such as "PyTorch 2.3.0"
    # calls that loading the file with Stable-Baselines3 would make and that models do not need, and pickles that could
    # not be examined, each as a phrase that names the place
    suspicions: tuple[str, ...]


def read_archive(path: Path) -> Archive:
    """Read a model's file.

    Raises:
        InputError: if the file was not saved by Stable-Baselines3, is damaged, or unpacks to too many bytes or values.
    """
    reader = PickleReader()
    try:
        packed = read_file(path, MAX_BYTES)
        with _opened(path, packed) as file:
            _check_members(path, file, len(packed))
            data = _settings(file)
            about = member(file, SYSTEM)[:MAX_ABOUT].decode(errors="replace") if SYSTEM in file.namelist() else ""
            tensors = {name: member(file, name) for name in file.namelist() if name.endswith(".pth")}
        settings, of_data = _read_settings(path, data, reader)
        of_tensors = [said for name, content in tensors.items() for said in _of_tensors(path, name, content, reader)]
    except InputError:
        raise
    except TooLongError as error:
        raise InputError(f"The pickles in {path} have {error}, which no model needs; it was not read") from None
    except Exception as error:  # zipfile, zlib and json raise many kinds of errors for damaged files
        raise InputError(f"{path} is not a zip file of Stable-Baselines3, or is damaged: {error}") from None
    digest = f"sha256:{hashlib.sha256(packed).hexdigest()}"
    numbers = {key: value for key, value in data.items() if isinstance(value, int | float)}
    python = _PYTHON.search(about)
    return Archive(
        path=path,
        packed=packed,
        digest=digest,
        settings=MappingProxyType(settings),
        numbers=MappingProxyType(numbers),
        weights=tensors[WEIGHTS],
        optimizer=tensors.get(OPTIMIZER),
        python=python[1] if python else "",
        versions=tuple(f"{name} {version}" for name, version in _VERSIONS.findall(about)),
        suspicions=(*of_data, *of_tensors),
    )


def suspicions_about(place: str, names: frozenset[str]) -> list[str]:
    """Return a phrase for each name of a pickle that saved models do not ordinarily contain."""
    if all(map(_OF_TENSOR.fullmatch, names)):
        return []
    unusual = sorted(name for name in names if not _ORDINARY.match(name))
    return [f"{place} calls {name}, which was not run" for name in unusual]


def _opened(path: Path, packed: bytes) -> ZipFile:
    if packed.startswith(pickle.PROTO):
        raise InputError(
            f"{path} is a pickle, such as a replay buffer or the statistics of VecNormalize, and no policy: give the "
            "model's zip file"
        )
    return ZipFile(io.BytesIO(packed))


def _check_members(path: Path, file: ZipFile, packed: int) -> None:
    """Check the members of a zip file before anything is unpacked."""
    if missing := {DATA, WEIGHTS} - set(file.namelist()):
        raise InputError(f"{path} is not a model of Stable-Baselines3: it has no {', '.join(sorted(missing))}")
    unpacked = unpacked_size(file)
    if unpacked > min(MAX_BYTES, max(LARGE, MAX_RATIO * packed)) or file.getinfo(DATA).file_size > MAX_DATA:
        raise InputError(f"{path} would unpack to {unpacked} bytes, which no model needs; it was not read")


def _settings(file: ZipFile) -> dict[str, Any]:
    data = json.loads(member(file, DATA))
    if not isinstance(data, dict):
        raise ValueError("its data is not a JSON object")  # noqa: TRY004 - it comes from a file
    return data


def _read_settings(path: Path, data: Mapping[str, Any], reader: PickleReader) -> tuple[dict[str, Any], list[str]]:
    """Return the entries of `SETTINGS` among a model's settings, and the suspicions about all of the settings.

    Raises:
        InputError: if one of the entries cannot be read.
    """
    settings, suspicions = {}, []
    for key, value in data.items():
        place = f"{key!r} of its data"
        try:
            content, found = _content(place, value, reader)
            if key in SETTINGS:
                check_extent(content)
                settings[key] = content
            suspicions += found
        except TooLongError:
            raise
        except ValueError as error:
            if key in SETTINGS:
                raise InputError(f"The data of {path} cannot be read: {key}: {error}") from None
            suspicions.append(f"{place} was not examined, because it is {error}")
    return settings, suspicions


def _content(place: str, value: Any, reader: PickleReader) -> tuple[Any, list[str]]:
    """Return a setting as it stands in the JSON, or the contents of its pickle, and the suspicions about it."""
    if not (isinstance(value, dict) and ":serialized:" in value):
        return value, []
    try:
        pickled = base64.b64decode(str(value[":serialized:"]), validate=True)
    except binascii.Error as error:
        raise ValueError(f"not readable as base64: {error}") from None
    content, names = reader.read(pickled)
    return content, suspicions_about(place, names)


@contextmanager
def opened_torch(what: str, data: bytes) -> Iterator[ZipFile]:
    """Open a file of torch with the contents `data`, called `what` in messages.

    Raises:
        InputError: if it is larger unpacked, or a program.
    """
    with ZipFile(io.BytesIO(data)) as file:
        unpacked = unpacked_size(file)
        if unpacked > len(data):  # torch does not compress
            raise InputError(f"{what} would unpack to {unpacked} bytes, which torch never writes; it was not read")
        if any("/code/" in name for name in file.namelist()):
            raise InputError(f"{what} is a program of TorchScript, which is not run: {SAVE_WEIGHTS}")
        yield file


def _of_tensors(path: Path, name: str, content: bytes, reader: PickleReader) -> list[str]:
    """Return the suspicions about a file of tensors: a zip file that contains a pickle.

    Raises:
        InputError: if the file has a format of earlier versions of torch, is too large unpacked, or is a program.
        ValueError: if it is no such file, or its pickle cannot be read.
    """
    if content.startswith(_OLD_TORCH):
        raise InputError(
            f"{name} in {path} has the format of torch before 1.6, which is not read: if you trust its origin, load "
            "the model with Stable-Baselines3, and save it again"
        )
    if not content.startswith(b"PK"):
        raise ValueError(f"its {name} is not a file that torch wrote")
    with opened_torch(f"{name} in {path}", content) as tensors:
        pickled = [member(tensors, part) for part in tensors.namelist() if part.endswith(".pkl")]
    return [said for data in pickled for said in suspicions_about(name, reader.read(data)[1])]
