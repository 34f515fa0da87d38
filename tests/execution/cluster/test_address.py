"""What may be said of a cluster on the command line."""

import socket
import subprocess
import sys

import pytest

from behavexplor.commands import BAD_INPUT, main
from behavexplor.errors import InputError
from behavexplor.execution.cluster.address import KINDS, parse_cluster


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ray", ("ray", "")),
        ("dask", ("dask", "")),
        ("ray:auto", ("ray", "auto")),
        ("ray:10.0.0.5:6379", ("ray", "10.0.0.5:6379")),
        ("ray://head.example:10001", ("ray", "ray://head.example:10001")),
        ("ray:ray://head.example:10001", ("ray", "ray://head.example:10001")),
        ("dask:tcp://10.0.0.5:8786", ("dask", "tcp://10.0.0.5:8786")),
        ("dask:tls://[fe80::1]:8786", ("dask", "tls://[fe80::1]:8786")),
        ("dask:localhost:8786", ("dask", "localhost:8786")),
    ],
)
def test_names_of_clusters(text, expected):
    assert parse_cluster(text) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("spark", "Unknown cluster .*'spark': known are dask, ray"),
        ("rai", "did you mean 'ray'"),
        ("", "Unknown cluster"),
        ("ray:", "--cluster ray: has an invalid address: write it as ray:10.0.0.5:6379"),
        ("ray:somewhere", "has an invalid address"),
        ("ray:tcp://10.0.0.5:6379", "has an invalid address"),
        ("dask:auto", "has an invalid address: write it as dask:tcp://10.0.0.5:8786"),
        ("dask:10.0.0.5:87860", "has an invalid address"),
        ("dask:10.0.0.5:0", "has an invalid address"),
        ("dask:http://10.0.0.5:8786", "has an invalid address"),
    ],
)
def test_wrong_names_are_refused(text, message):
    with pytest.raises(InputError, match=message):
        parse_cluster(text)


def fuzz(capsys, *flags):
    code = main(["fuzz", "--env", "lane-follow", "--ads", "constant", "--budget", "3", *flags])
    return code, capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("kind", KINDS)
def test_a_library_that_is_not_installed_is_named(kind, capsys, monkeypatch, tmp_path):
    library = {"ray": "ray", "dask": "distributed"}[kind]
    monkeypatch.setitem(sys.modules, library, None)
    code, said = fuzz(capsys, "--cluster", kind, "--out", str(tmp_path / "run"))
    assert code == BAD_INPUT
    assert f"--cluster {kind} needs {library}: install the extra '{kind}'" in said
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("kind", KINDS)
def test_a_cluster_that_does_not_answer_is_named(kind, capsys, tmp_path):
    with socket.socket() as nobody:  # it does not listen
        nobody.bind(("127.0.0.1", 0))
        port = nobody.getsockname()[1]
        code, said = fuzz(capsys, "--cluster", f"{kind}:127.0.0.1:{port}", "--out", str(tmp_path / "run"))
    assert code == BAD_INPUT
    assert f"No cluster answers at 127.0.0.1:{port} (" in said
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--cluster", "slurm"], "Unknown cluster"),
        (["--cluster", "ray", "--workers", "0"], "--workers 0 must lie between 1 and 256 on a cluster"),
        (["--workers", "65"], "--workers 65 must lie between 0 and 64"),
    ],
)
def test_wrong_flags_are_refused_in_a_sentence(flags, message, capsys):
    code, said = fuzz(capsys, *flags)
    assert code == BAD_INPUT
    assert message in said


def test_nobody_who_has_no_cluster_imports_what_it_needs():
    code = "import sys, behavexplor.commands.fuzz; print(sorted({'ray', 'dask', 'distributed'} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
