"""The documentation site shows every page, builds without a warning, has no dead link, and fetches nothing."""

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
import yaml

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
MADE = {"index.md", "contributing.md", "changelog.md", "gallery.md"}  # pages that are not in docs/
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
LOADED = {"img", "script", "iframe", "link", "source"}  # elements whose targets a browser fetches with the page


def built(config: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    pytest.importorskip("mkdocs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", config, "-d", folder]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)


def leaves(node) -> Iterator[str]:
    """The strings in nested lists and dictionaries."""
    if isinstance(node, str):
        yield node
    else:
        for child in node.values() if isinstance(node, dict) else node:
            yield from leaves(child)


def test_every_page_is_in_the_navigation():
    shown = sorted(leaves(yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]))
    pages = {path.relative_to(DOCS).with_suffix(".md").as_posix() for path in DOCS.rglob("*.[mi][dp]*")}
    assert shown == sorted(pages | MADE)


@pytest.mark.parametrize("target", ["none.md", "index.md#none", "/index.md", "data/none.csv"])
def test_a_dead_link_fails_the_build(tmp_path, target):
    """The settings of the site, on a site of one page."""
    (tmp_path / "pages").mkdir()
    page = tmp_path / "pages" / "index.md"
    config = tmp_path / "mkdocs.yml"
    own = {"docs_dir": "pages", "nav": ["index.md"], "hooks": [], "plugins": [], "extra_css": [], "theme": "mkdocs"}
    config.write_text(yaml.safe_dump({"INHERIT": str(ROOT / "mkdocs.yml"), **own}))
    page.write_text("# Title\n\n[alive](#title)\n")
    result = built(config, tmp_path / "site")
    assert result.returncode == 0, result.stderr
    page.write_text(f"# Title\n\n[dead]({target})\n")
    result = built(config, tmp_path / "site")
    assert result.returncode == 1
    assert target in result.stderr


class Page(HTMLParser):
    """The ids of a page, what it links to, and what a browser fetches with it."""

    def __init__(self, path):
        super().__init__()
        self.ids, self.targets, self.loaded, self.texts = set(), set(), set(), []
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.ids.add(values.get("id"))
        if tag == "img":
            self.texts.append(values.get("alt") or "")
        target = values.get("src") or values.get("href")
        if target and tag == "a":
            self.targets.add(target)
        elif target and tag in LOADED and values.get("rel") != "canonical":
            self.loaded.add(target)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The pages of the site, by their paths."""
    folder = tmp_path_factory.mktemp("site")
    result = built(ROOT / "mkdocs.yml", folder)
    assert result.returncode == 0, result.stderr
    return {path: Page(path) for path in folder.rglob("*.html") if path.name != "404.html"}  # its links are absolute


@pytest.mark.slow
def test_the_site_has_no_dead_link(site):
    """Targets inside the report are the business of its script."""
    seen = 0
    for path, page in site.items():
        for target in page.targets | page.loaded:
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            found = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert found.exists(), f"{path} leads to {target}"
            if parts.fragment and found in site and found.name != "report.html":
                assert unquote(parts.fragment) in site[found].ids, f"{path} leads to {target}"
            seen += 1
    assert seen > 1000


@pytest.mark.slow
def test_the_site_fetches_nothing_from_elsewhere(site):
    fetched = {target for page in site.values() for target in page.loaded}
    assert fetched
    assert not {target for target in fetched if urlsplit(target).netloc}


@pytest.mark.slow
def test_the_site_has_the_interface_and_a_gallery_whose_failures_can_be_played(site):
    pages = {path.name: (path, page) for path, page in site.items() if path.parent.name != "environments"}
    assert {"behavexplor.find_failures", "behavexplor.Run.replay"} <= pages["interface.html"][1].ids
    path, gallery = pages["gallery.html"]
    played = {target for target in gallery.targets if re.match(r"gallery/report.html#\d/R", target)}
    report = (path.parent / "gallery" / "report.html").read_text()
    assert len(played) >= 5
    assert {target.split("#")[1][0] for target in played} == {"1", "2", "3"}  # the planner and both policies fail
    for target in played:
        assert f'"{target.split("#")[1][2:].rpartition("/")[0]}"' in report
    assert not [text for text in gallery.texts if not text.endswith("seen from above")]


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="needs a browser: apt-get install chromium")
def test_the_site_has_a_search_from_a_disk(site):
    index = next(path for path in site if path.name == "index.html" and (path.parent / "search").is_dir())
    quiet = ["--headless=new", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000", "--dump-dom"]
    command = [BROWSER, *quiet, f"{index.as_uri()}?q=niching"]
    found = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
    assert re.search(r"\d+ matching documents", found)
