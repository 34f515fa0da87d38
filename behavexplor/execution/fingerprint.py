"""Machine fingerprints: machines with equal fingerprints produce equal records for equal configurations."""

import hashlib
import json
import platform
import socket
import sys
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from behavexplor.ads.loading import SYSTEMS
from behavexplor.execution.checked_imports import source_files

FINGERPRINT: Final = "fingerprint"  # the function of a service
NODE: Final = "node"  # key of the host name
_PACKAGE = Path(__file__).parent.parent
_LIBRARIES = {  # libraries that compute results, by the name of the imported module
    "gymnasium": "gymnasium",
    "highway_env": "highway-env",
    "numba": "numba",
    "numpy": "numpy",
    "sb3_contrib": "sb3-contrib",
    "scipy": "scipy",
    "stable_baselines3": "stable-baselines3",
    "torch": "torch",
}


def fingerprint(ads: bytes) -> bytes:
    """Return the fingerprint of this process, with the libraries that it has loaded, as a JSON object of strings.

    The names of driving systems are a JSON list, see `behavexplor.ads.loading.load_ads`.
    """
    return _fingerprint(json.loads(ads), [name for module, name in _LIBRARIES.items() if module in sys.modules])


def machine_fingerprint(ads: Iterable[str]) -> bytes:
    """Return the fingerprint of this machine, with all installed libraries and driving systems of these names.

    No ADS is loaded.
    """
    return _fingerprint(ads, library_versions())


def library_versions() -> dict[str, str]:
    """Return the versions of the installed libraries that compute results, by name."""
    versions = {}
    for name in _LIBRARIES.values():
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return versions


def _fingerprint(ads: Iterable[str], libraries: Iterable[str]) -> bytes:
    found = {
        NODE: socket.gethostname(),
        "Python": ".".join(platform.python_version_tuple()[:2]),
        "kind of processor": platform.machine(),
        "behavexplor": _digest(_PACKAGE, [*_PACKAGE.rglob("*.py"), *_PACKAGE.rglob("*.npz")]),
    }
    found |= {library: version(library) for library in libraries}
    for name in ads:
        found |= _ads_digest(name)
    return json.dumps(found).encode()


def difference(theirs: bytes, ours: bytes) -> str | None:
    """Return a sentence on why a node would not reproduce this machine's results; None if it would."""
    found, wanted = json.loads(theirs), json.loads(ours)
    for name in sorted(found.keys() & wanted.keys() - {NODE}):
        if found[name] != wanted[name]:
            other = f"The node {found[NODE]} has a different {name} ({found[name]}) than this machine ({wanted[name]})"
            return f"{other}, so its results could differ: install the same on every node"
    return None


def _ads_digest(name: str) -> dict[str, str]:
    """Return the digest of the file or folder that an ADS is loaded from; empty for an ADS of this package."""
    path, module = Path(name), name.partition(":")[0]
    if module in SYSTEMS:
        return {}
    if path.exists():
        files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
        return {name: _digest(path.parent, files)}
    source = source_files(module).get(module)
    return {} if source is None else {f"file of {module}": _digest(source.parent, [source])}


def _digest(folder: Path, files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(f"{file.relative_to(folder).as_posix()}\0".encode())
        with file.open("rb") as content:
            digest.update(hashlib.file_digest(content, "sha256").digest())
    return digest.hexdigest()[:16]
