"""The notebooks in docs/notebooks run as they are printed, and an interrupted one resumes."""

import os
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

DOCS = Path(__file__).parent.parent / "docs"


def execute(notebook, folder):
    client = NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(folder)}})
    client.execute(env={**os.environ, "PYTHONPATH": str(DOCS.parent)})


def executed(name, folder):
    """The HTML and the texts that a notebook shows."""
    notebook = nbformat.read(DOCS / "notebooks" / name, as_version=4)
    execute(notebook, folder)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert not [output for output in outputs if output.get("name") == "stdout"]
    return [output.data.get("text/html", output.data["text/plain"]) for output in outputs if "data" in output]


NOTEBOOKS = sorted(path.name for path in (DOCS / "notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_notebook_runs(name, tmp_path):
    shown = executed(name, tmp_path)
    text = "".join(shown)
    assert "<table" in text
    if name != "write_a_requirement_and_a_method.ipynb":
        assert '<img alt="Execution' in text
        assert 'src="data:image/gif;base64,R0lGOD' in text
    if name == "fuzz_a_policy.ipynb":
        assert "executions, " in text  # the progress
        assert (tmp_path / "runs").is_dir()


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
