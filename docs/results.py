"""Puts the tables of an experiment into docs/results.md: python docs/results.py FOLDER.

FOLDER is that of the experiment, such as runs/paper. A table stands between the lines `<!-- table: paper/NAME -->` and
`<!-- end -->`, where `paper` is the name of FOLDER, and NAME that of a file in FOLDER/tables. The page explains a table
itself, so the notes below it are left out. A table that FOLDER does not have stays as it is.
"""

import re
import sys
from pathlib import Path

PAGE = Path(__file__).parent / "results.md"
PLACE = re.compile(r"(?<=<!-- table: )([\w-]+)/([\w.+~-]+) -->\n.*?(?=<!-- end -->)", re.DOTALL)


def filled(page: str, folder: Path) -> str:
    """The page with the tables of an experiment in their places."""

    def place(found: re.Match[str]) -> str:
        path = folder / "tables" / f"{found[2]}.md"
        if found[1] != folder.name or not path.is_file():
            return found[0]
        return f"{found[1]}/{found[2]} -->\n\n{_without_notes(path.read_text())}\n\n"

    return PLACE.sub(place, page)


def _without_notes(table: str) -> str:
    """A table with its title, but without the notes, which are the last paragraph."""
    return table[: table.rindex("|\n") + 1]


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(), Path(sys.argv[1])))
