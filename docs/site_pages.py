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
from traitlets.config import Config

import behavexplor
from behavexplor.report.reading import read_run
from behavexplor.report.run_page import page as report

ROOT = Path(__file__).parent.parent
BESIDE_DOCS = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)[^)#\s]+")
POLICIES = ROOT / "docs" / "data" / "policies"
GALLERY = (  # driver, environment and number of executions of the gallery's campaigns
    ("rule", "intersection-straight", 150),
    (str(POLICIES / "highway-fast.zip"), "highway-fast-v0", 400),
    (str(POLICIES / "roundabout.zip"), "roundabout-v0", 100),
)
MOST_SHOWN = 6  # classes of each campaign


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
    exporter = MarkdownExporter(
        config=Config({"ExtractOutputPreprocessor": {"enabled": False}})
    )  # pictures in the page
    text, _ = exporter.from_filename(str(ROOT / path))
    text = text.replace("![png](", "![The decisive moment of an execution, seen from above](")
    return f"{text}\n[This page as a notebook]({posixpath.basename(path)})\n"


def gallery() -> Iterator[tuple[str, str | bytes]]:
    """Run small campaigns, and yield the files that show their failures: pictures, the report, and a page."""
    sections, runs = "", []
    with tempfile.TemporaryDirectory() as folder:
        for number, (driver, env, budget) in enumerate(GALLERY, 1):
            run = behavexplor.find_failures(driver, env, budget=budget, confirm=False, out=f"{folder}/{number}-{env}")
            runs.append(read_run(run.folder))
            found = run.summary
            sections += f"\n## {Path(found.ads).name} in {env}\n\n{found.executions} executions, {found.words}.\n"
            for one in found.classes[:MOST_SHOWN]:
                picture = BytesIO()
                run.replay(one.first).picture.save(picture, "png", optimize=True)
                name = f"gallery/{number}-{one.first}.png"
                yield name, picture.getvalue()
                play = f"gallery/report.html#{number}/{one.id}/{one.first}"
                sections += (
                    f"\n### {one.words}\n\n"
                    f"Failures: {one.count}, the first in execution {one.first}. [Play it]({play}).\n\n"
                    f"[![{one.words}, seen from above]({name})]({play})\n"
                )
        yield "gallery/report.html", report(runs, 100)
    yield (
        "gallery.md",
        "# Gallery of failures\n\n"
        "What some drivers did when this site was built: the planner of this package, and two policies that were "
        "trained with PPO in highway-env's environments. This page shows the decisive moment of the first failure of "
        f"each class, of at most {MOST_SHOWN} classes of each driver. A picture leads to the "
        f"[report](gallery/report.html), which plays this failure and others, step by step if you like.\n{sections}",
    )
