"""Puts the tables of an experiment into docs/results.md: python docs/results.py FOLDER.

The folder is that of the experiment, such as runs/paper. A table stands between the lines `<!-- table: NAME -->` and
`<!-- end -->`, and NAME is the name of its file in FOLDER/tables. A table that the folder does not have stays as it is.
"""

import re
import sys
from pathlib import Path

PAGE = Path(__file__).parent / "results.md"
PLACE = re.compile(r"(?<=<!-- table: )([\w.+~-]+)( -->\n).*?(?=<!-- end -->)", re.DOTALL)


def filled(page: str, tables: Path) -> str:
    """The page with the tables in a folder in their places."""

    def place(found: re.Match[str]) -> str:
        path = tables / f"{found[1]}.md"
        return f"{found[1]}{found[2]}\n{path.read_text()}\n" if path.is_file() else found[0]

    return PLACE.sub(place, page)


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(), Path(sys.argv[1]) / "tables"))
