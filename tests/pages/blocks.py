"""The code blocks of README, CONTRIBUTING and the pages in docs/, and how a test runs them.

A Python block runs as it is printed, after the blocks before it on its page; if its first line is a comment with a
file's name, it is that file. Each line of a shell block runs in this process, in a folder of its own.

What is changed: counts are lowered to `MOST`, and commands get the flags of `SMALL`, which come last and so count. RUN
is a finished run, and 17 and 43 are failures of it.
"""

import re
import shlex
from pathlib import Path
from typing import NamedTuple

from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]

MOST = 16  # executions, scenarios or training steps that a Python block asks for
SMALL = {
    "bench": "--jobs 1",
    "check": "--workers 0",
    "compare": "--scenarios 4 --budget 8 --workers 0 --unconfined",
    "evaluate": "--scenarios 2 --workers 0 --unconfined",
    "fuzz": f"--budget {MOST} --workers 0 --unconfined",
    "minimize": "--workers 0",
    "retrain": "--rounds 1 --steps 128 --budget 2 --validation 2",
    "suite": "--workers 0",
    "train": "--steps 128 --envs 2",
    "triage": "--workers 0",
}
FILE = re.compile(r"# (\w+\.(?:py|yaml))\n")
COUNT = re.compile(r"(\b(?:budget|scenarios)=|\.learn\()(\d[\d_]*)")


class Block(NamedTuple):
    """A code block: its page, the line at which it begins, its language ("" if none is named), and its text."""

    page: str
    line: int
    language: str
    text: str

    @property
    def file(self) -> str:
        """The name of the file that the block is; empty if it is none."""
        found = FILE.match(self.text)
        return found[1] if found else ""

    @property
    def commands(self) -> list[str]:
        """The lines of a shell block, without comments."""
        lines = [re.sub(r"(^|\s+)#.*", "", line) for line in self.text.splitlines()]
        return [line for line in lines if line]


def blocks_of(page: Path) -> list[Block]:
    """The code blocks of a page, in order."""
    tokens = MarkdownIt("commonmark").parse(page.read_text())
    name = page.relative_to(ROOT).as_posix()
    return [
        Block(name, token.map[0] + 1, token.info if token.type == "fence" else "indented", token.content)
        for token in tokens
        if token.type in {"fence", "code_block"}
    ]


def lowered(code: str) -> str:
    """Python code with its counts lowered."""
    return COUNT.sub(lambda match: f"{match[1]}{min(int(match[2]), MOST)}", code)


def arguments_of(command: str) -> list[str] | None:
    """The arguments of a line that calls behavexplor, with the flags of `SMALL`; None if it calls another program."""
    found = re.fullmatch(r"(?:\./run|behavexplor|python -m behavexplor[ .])\s*(.*)", command)
    if found is None:
        return None
    name, *rest = shlex.split(found[1])
    small = SMALL.get(name, "").split()
    flags = {word for word in small if word.startswith("--")}
    before = ["", *rest]  # a flag is given once; all that are replaced have values, but --unconfined
    kept = [word for i, word in enumerate(rest) if word not in flags and before[i] not in flags - {"--unconfined"}]
    return [name, *kept, *small]
