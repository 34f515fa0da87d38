"""XML files that may come from elsewhere: reading, and comparison of roads. Nothing outside a file is loaded."""

from pathlib import Path
from typing import Any, Final

from lxml import etree

from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError

Element = Any

MAX_SIZE: Final = 200_000_000  # [bytes]; a scene of 200 s with six vehicles has 4 million


def read_xml(path: Path) -> Element:
    """Return the root of an XML file, without comments.

    Raises:
        InputError: if it is not an XML file, or is too long.
    """
    try:
        data = read_file(path, MAX_SIZE)
    except OSError as error:
        hint = ": name one of the files in it" if path.is_dir() else ""
        raise InputError(f"{path} cannot be read: {error.strerror}{hint}") from None
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, remove_comments=True, remove_pis=True, remove_blank_text=True
    )
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        said = getattr(error, "msg", error)
        raise InputError(f"{path} cannot be read as XML, which `export` writes without --format csv: {said}") from None
    if next(root.iter(etree.Entity), None) is not None:
        raise InputError(f"{path} has entities of its own, which are not read")
    return root


def same_road(path: Path, other: Path) -> bool:
    """Return whether two OpenDRIVE files describe the same road; their headers and layout may differ.

    Raises:
        InputError: if one of them is not an XML file.
    """
    return _canonical(path) == _canonical(other)


def _canonical(path: Path) -> str:
    root = read_xml(path)
    for header in root.findall("header"):
        root.remove(header)
    return str(etree.canonicalize(etree.tostring(root, encoding="unicode"), strip_text=True))
