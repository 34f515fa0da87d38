"""Files from elsewhere: plain values are read, and what would be too large is refused before it is made."""

import gzip
import io
import struct
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest

from behavexplor.ads.sb3 import archive
from behavexplor.ads.weights import tensors
from behavexplor.data.untrusted import MAX_DEPTH, MAX_NODES, decompressed, parse_yaml, read_arrays
from behavexplor.errors import InputError

HUGE = bytes(10**8)
SMALL = 10**7


def test_plain_values_are_read():
    text = "seed: 3\nenv: lane-follow\nshare: 0.5\nbudget: 1:30\nlimit: 0x10\nnames: [a, b]"
    values = {"seed": 3, "env": "lane-follow", "share": 0.5, "budget": 90, "limit": 16, "names": ["a", "b"]}
    assert parse_yaml(text) == values
    assert parse_yaml("") is None
    assert parse_yaml("a: &a {x: 1}\nb: &b {y: 2}\nc: {<<: *a, <<: *b, x: 3}")["c"] == {"x": 3, "y": 2}
    assert parse_yaml("a: {x: 1}\nb: {x: 1}\n1: a\n'1': b") == {"a": {"x": 1}, "b": {"x": 1}, 1: "a", "1": "b"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed: 0x" + "f" * 9000, "an integer in it is too long"),
        ("seed: " + "9" * 5000, "an integer in it is too long"),
        ("budget: 1" + ":59" * 3000, "an integer in it is too long"),
        ("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "nested too deeply"),
        ("&a [*a]", "nested too deeply"),
        (f"- &a [{', '.join('x' * 400)}]\n- [{', '.join(['*a'] * (MAX_NODES // 400))}]", "aliases make it too large"),
        ("budget: 3\nenv: lane-follow\nbudget: 30", "the key 'budget' stands twice, again in line 3"),
        ("a: [{'x': 1, \"x\": 2}]", "the key 'x' stands twice, again in line 1"),
        ("a: !!python/object:os.system {}", "could not determine a constructor"),
    ],
)
def test_values_that_would_be_too_large_are_refused(text, message):
    with pytest.raises(ValueError, match=message):
        parse_yaml(text)


def lying(*members, method=zipfile.ZIP_DEFLATED):
    """A zip file with members of 100 MB, each of which says that it has 1000 bytes."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as new:
        for name in members:
            new.writestr(name, HUGE)
    data = bytearray(file.getvalue())
    at = -1
    while (at := data.find(b"PK\x01\x02", at + 1)) >= 0:
        struct.pack_into("<I", data, at + 24, 1000)
    return bytes(data)


@pytest.mark.parametrize(
    ("read", "members"),
    [
        (archive.read_archive, ("data", "policy.pth")),
        (tensors.read_tensors, ("archive/data.pkl", "archive/data/0")),
        (lambda path: read_arrays(path.read_bytes()), ("a.npy",)),
        (lambda path: read_arrays(path.read_bytes()), ("a",)),
    ],
    ids=["model", "weights", "arrays", "other members"],
)
@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_no_more_is_unpacked_than_a_zip_file_says(read, members, method, tmp_path, monkeypatch):
    for module in (archive, tensors):
        monkeypatch.setattr(module, "MAX_BYTES", SMALL // 2)  # as much is made room for when a file is read
    path = tmp_path / "file.zip"
    path.write_bytes(lying(*members, method=method))
    tracemalloc.start()
    try:
        with pytest.raises((InputError, ValueError)):
            read(path)
        assert tracemalloc.get_traced_memory()[1] < SMALL
    finally:
        tracemalloc.stop()


def test_no_more_is_decompressed_than_wanted():
    packed = gzip.compress(HUGE)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="would unpack to more than 1000 bytes"):
            decompressed(packed, 1000)
        assert tracemalloc.get_traced_memory()[1] < SMALL
    finally:
        tracemalloc.stop()
    assert decompressed(packed, len(HUGE)) == HUGE
    with pytest.raises(ValueError, match="cut short"):
        decompressed(packed[:-9])
    with pytest.raises(zlib.error):
        decompressed(b"rubbish")


def test_arrays_are_read_by_name():
    file = io.BytesIO()
    np.savez_compressed(file, a=np.arange(3), b=np.float32(2.5))
    arrays = read_arrays(file.getvalue())
    assert (list(arrays), arrays["a"].tolist(), float(arrays["b"])) == (["a", "b"], [0, 1, 2], 2.5)
