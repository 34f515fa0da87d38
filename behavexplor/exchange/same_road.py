"""Comparison of OpenDRIVE files."""

from pathlib import Path
from typing import Final

from lxml import etree

from behavexplor.errors import InputError

MAX_SIZE: Final = 50_000_000  # [bytes]


def same_road(path: Path, other: Path) -> bool:
    """Return whether two OpenDRIVE files describe the same road, whatever their headers and their layout.

    Raises:
        InputError: if one of them is not an XML file.
    """
    return _canonical(path) == _canonical(other)


def _canonical(path: Path) -> str:
    if path.stat().st_size > MAX_SIZE:
        raise InputError(f"{path} is too long: a road has at most {MAX_SIZE} bytes")
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True, remove_blank_text=True)
    try:
        root = etree.parse(path, parser).getroot()
    except (etree.XMLSyntaxError, OSError) as error:
        raise InputError(f"{path} is not an XML file: {error}") from None
    for header in root.findall("header"):
        root.remove(header)
    return str(etree.canonicalize(etree.tostring(root, encoding="unicode"), strip_text=True))
