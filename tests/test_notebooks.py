"""The notebooks in docs/notebooks show what they return when they run, and an interrupted one resumes."""

import os
import runpy
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

DOCS = Path(__file__).parent.parent / "docs"


def execute(notebook, folder):
    client = NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(folder)}})
    client.execute(env={**os.environ, "PYTHONPATH": str(DOCS.parent)})


BUILD = runpy.run_path(str(DOCS / "build.py"))
MOST_BYTES = 100_000  # of a notebook with what it shows


def texts_of(notebook):
    """The HTML and the texts that a notebook shows; "picture" for each picture."""
    outputs = [output.data for cell in notebook.cells for output in cell.get("outputs", ())]
    return ["picture" if "image/png" in one else one.get("text/html", one["text/plain"]) for one in outputs]


@pytest.mark.slow
@pytest.mark.parametrize("path", [pytest.param(path, id=path.stem) for path in BUILD["NOTEBOOKS"]])
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_notebook_shows_what_it_returns_when_it_runs(path, tmp_path):
    """If this fails, run python docs/build.py --notebooks."""
    kept = nbformat.read(path, as_version=4)
    assert texts_of(kept) == texts_of(BUILD["shown"](path, tmp_path))
    assert "<table" in "".join(texts_of(kept))
    if path.stem != "write_a_requirement_and_a_method":
        assert texts_of(kept).count("picture") == 1
    assert path.stat().st_size < MOST_BYTES


SEARCH = """
import os, signal, threading, time
from pathlib import Path

import behavexplor


def drive(observation):
    return 3


def interrupt():  # as the notebook's button does
    while not any(Path("run").glob("failures/*.json")):
        time.sleep(0.1)
    os.kill(os.getpid(), signal.SIGINT)


threading.Thread(target=interrupt, daemon=True).start()
behavexplor.find_failures(drive, "highway-fast-v0", budget=5000, out="run", confirm=False)
"""
RESUME = """
run = behavexplor.open_run("run")
count = len(run)
run.resume(drive, budget=count + 3)
0 < count < 5000, len(run) - count
"""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_an_interrupted_notebook_leaves_a_run_that_resumes(tmp_path):
    search = nbformat.v4.new_code_cell(SEARCH, metadata={"tags": ["raises-exception"]})
    resume = nbformat.v4.new_code_cell(RESUME)
    execute(nbformat.v4.new_notebook(cells=[search, resume]), tmp_path)
    (error,) = [output for output in search.outputs if output.output_type == "error"]
    assert error.ename == "Interrupted"
    assert "open_run('run', driver).resume()" in error.evalue
    (result,) = [output for output in resume.outputs if output.output_type == "execute_result"]
    assert result.data["text/plain"] == "(True, 3)"
