"""What is printed fits the terminal: nothing is cut, and nothing runs into another line or column."""

import os
import re
import subprocess
import sys

import pytest

from behavexplor.commands import OK, main
from behavexplor.commands.arguments import COMMANDS

WIDTHS = (80, 60)
RUNNING = ["--workers", "0", "--quiet"]


def too_wide(text, columns):
    """The lines that do not fit. What is copied stands on lines of its own: commands, paths, digests, Python."""
    copied = re.compile(
        r" *(\$ |behavexplor |ADS=NAME |All results are in |[A-Z][^:]*: (RUN|OUT)/|sha256:|env = |observation, )"
    )
    shown = [line for line in text.splitlines() if not copied.match(line)]
    return [line for line in shown if len(line) > columns or "\N{HORIZONTAL ELLIPSIS}" in line]


@pytest.mark.parametrize("columns", WIDTHS)
@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_fits(command, columns, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(columns))
    arguments = [command, "--help"] if command else ["--help"]
    try:
        assert main(arguments) == OK
    except SystemExit as end:
        assert end.code in (None, OK)
    text = capsys.readouterr().out
    assert text.startswith("usage: ")
    assert not too_wide(text, columns)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run with crashes of several classes, whose names are long."""
    folder = tmp_path_factory.mktemp("wide") / "run"
    arguments = ["--env", "roundabout-v0", "--ads", "constant:FASTER", "--budget", "40", "--no-confirm"]
    assert main(["fuzz", *arguments, "--out", str(folder), *RUNNING]) == OK
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("columns", WIDTHS)
@pytest.mark.parametrize(
    "command",
    [
        "fuzz --resume RUN",
        "status RUN",
        "triage RUN --workers 0",
        "minimize RUN --workers 0",
        "replay RUN FIRST --out OUT/pictures",
        "report RUN --out OUT/page.html",
        "export RUN --out OUT/scenes && import OUT/scenes/FIRST.xosc --ads constant:FASTER",
        "suite RUN --out OUT/suite --workers 0 && check OUT/suite --workers 0",
        "evaluate --env roundabout-v0 --ads constant:FASTER --scenarios 30 --workers 0",
        "evaluate --env highway-fast-v0 --ads constant:FASTER --scenarios 30 --workers 0 --below 0.01",
        "compare constant:FASTER careful --env roundabout-v0 --scenarios 30 --workers 0 --out OUT/two",
        "fuzz --env lane-change --budget 30 --workers 0 --out OUT/other",
        "evaluate --env lane-change --ads idm --scenarios 30 --workers 0",
        "inspect docs/data/policies/roundabout.zip",
        "envs",
        "bench quick --dry-run",
        "bench quick --jobs 1 --out OUT/quick",
        "train --env lane-follow --steps 128 --envs 2 --out OUT/policy && zip OUT/policy/policy.npz --out OUT/it.zip",
        "retrain docs/data/policies/merge.zip --rounds 1 --steps 128 --budget 2 --validation 2 --out OUT/better",
        "demo --no-browser --budget 2 --steps 1024 --out OUT/demo",
    ],
)
def test_results_fit(command, columns, run, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("BEHAVEXPLOR_PROGRAM", "behavexplor")
    first = min(int(file.stem) for file in (run / "failures").glob("*.json"))
    words = command.replace("FIRST.xosc", f"{first:06}.xosc").replace("FIRST", str(first)).replace("OUT", str(tmp_path))
    for one in words.split(" && "):
        main([str(run) if word == "RUN" else word for word in one.split()])
    printed = capsys.readouterr()
    assert printed.out
    assert not too_wide(printed.out.replace(str(run), "RUN").replace(str(tmp_path), "OUT"), columns)


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("fuzz --env highway-f", "highway-fast-v0"),
        ("evaluate --env lane-c", "lane-change"),
        ("fuzz --method nic", "niching"),
        ("replay ru", "runs"),
    ],
)
def test_the_shell_completes_names_and_folders(typed, offered, tmp_path):
    (tmp_path / "runs").mkdir()
    script = subprocess.run(
        [sys.executable, "-m", "behavexplor", "--tyro-print-completion", "bash"],
        capture_output=True, text=True, check=True, env={**os.environ, "BEHAVEXPLOR_PROGRAM": "behavexplor"},
    ).stdout  # fmt: skip
    (tmp_path / "script").write_text(script)
    words = ["behavexplor", *typed.split()]
    told = subprocess.run(
        ["bash", "-c", 'source ./script; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _tyro_behavexplor; '
         'echo "${COMPREPLY[@]:-$(compgen -o default "${@: -1}")}"', "bash", *words],
        capture_output=True, text=True, check=True, cwd=tmp_path,
    )  # fmt: skip
    assert told.stdout.split() == [offered]
    assert "complete -o default -F _tyro_behavexplor behavexplor" in script  # files, if nothing is offered
