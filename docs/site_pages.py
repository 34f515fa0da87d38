"""Pages that mkdocs adds to those in docs/: README, CONTRIBUTING, CHANGELOG, notebooks, sources, and a gallery."""

import posixpath
import re
import tempfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbconvert import MarkdownExporter

import behavexplor

ROOT = Path(__file__).parent.parent
BESIDE_DOCS = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)[^)#\s]+")
BUDGET = 150  # executions of the gallery's campaign


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from other files, the sources to which pages link, and the gallery."""
    for path, uri in BESIDE_DOCS.items():
        files.append(File.generated(config, uri, content=linked((ROOT / path).read_text(), path)))
    for path in sorted(f"docs/{file.src_uri}" for file in files if file.src_uri.endswith(".ipynb")):
        files.append(File.generated(config, site_uri(path), content=notebook(path)))
    for path in sorted(sources()):
        files.append(File.generated(config, site_uri(path), abs_src_path=str(ROOT / path)))
    for uri, content in gallery():
        files.append(File.generated(config, uri, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Lead the links of a page in docs/ to where their targets are in the site."""
    return markdown if page.file.generated_by else linked(markdown, f"docs/{page.file.src_uri}")


def site_uri(path: str) -> str:
    """Return where a file of the repository is among the site's files."""
    if path.startswith("docs/"):
        return path.removeprefix("docs/").replace(".ipynb", ".md")
    return BESIDE_DOCS.get(path, f"source/{path}.txt")


def linked(markdown: str, path: str) -> str:
    """Return the page at a path of the repository with its links as they are in the site, but for dead ones."""
    here = posixpath.dirname(site_uri(path)) or "."

    def moved(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(path), match[0]))
        return posixpath.relpath(site_uri(target), here) if (ROOT / target).is_file() else match[0]

    return LINK.sub(moved, markdown)


def sources() -> set[str]:
    """Return the paths of the files outside of docs/ to which pages in docs/ link, but for those that are pages."""
    pages = (ROOT / "docs").rglob("*.md")
    targets = {(page.parent / target).resolve() for page in pages for target in LINK.findall(page.read_text())}
    paths = {target.relative_to(ROOT.resolve()).as_posix() for target in targets if target.is_file()}
    return {path for path in paths if not path.startswith("docs/") and path not in BESIDE_DOCS}


def notebook(path: str) -> str:
    """Return a notebook as a page."""
    text, _ = MarkdownExporter().from_filename(str(ROOT / path))
    return f"{text}\n[This page as a notebook]({posixpath.basename(path)})\n"


def gallery() -> Iterator[tuple[str, str | bytes]]:
    """Run a small campaign, and yield the files that show its failures: pictures, the report, and a page."""
    cards = ""
    with tempfile.TemporaryDirectory() as folder:
        run = behavexplor.find_failures("rule", "intersection-straight", budget=BUDGET, out=f"{folder}/run")
        found = run.summary
        for one in found.classes:
            picture = BytesIO()
            run.replay(one.first).picture.save(picture, "png", optimize=True)
            yield f"gallery/{one.first}.png", picture.getvalue()
            play = f"gallery/report.html#1/{one.id}/{one.first}"
            cards += (
                f"\n## {one.words}\n\n"
                f"Failures: {one.count}, the first in execution {one.first}. [Play it]({play}).\n\n"
                f"[![Execution {one.first}](gallery/{one.first}.png)]({play})\n"
            )
        yield "gallery/report.html", run.report().read_text()
    yield (
        "gallery.md",
        "# Gallery of failures\n\n"
        f"When this site was built, the planner `{found.ads}` drove {found.executions} scenarios of `{found.env}`. It "
        f"failed in {found.failed}, which are of {len(found.classes)} classes. This page shows the decisive moment "
        "of the first failure of each class. A picture leads to the [report](gallery/report.html), which plays this "
        f"failure and others, step by step if you like.\n{cards}",
    )
