"""Malformed input of every kind: what a user, a disk, or somebody with bad intentions may hand in; and its limits."""

import io
import json
import resource
import shutil
import signal
import zipfile
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import yaml

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.folder_format import DATABASE, FAILURES
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, main
from behavexplor.commands.shared_flags import WAITING
from tests.campaign.test_store import execution

SECONDS = 20  # for one input
GIBIBYTES = 6  # that this process may have
LONGEST = 1000  # characters of a sentence


class TooLongError(BaseException):
    """Something hangs; nobody catches that by mistake."""


@contextmanager
def limited():
    """A limit on the memory of this process, and on the time of an input."""

    def stop(*_):
        raise TooLongError

    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (GIBIBYTES * 2**30, before[1]))
    handler = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_DATA, before)


def is_sentence(text):
    """Whether a message is one line of printable characters that can be read in a terminal."""
    return 0 < len(text) < LONGEST and text.isprintable()


def refuse(capfd, *arguments, accepted=(BAD_INPUT,), sentences=1):
    """The program refuses its arguments in one sentence, or accepts them."""
    try:
        code = main(list(map(str, arguments)))
    except SystemExit as exit_:  # of the parser of flags
        code, sentences = exit_.code, None  # it draws a box
    out, err = capfd.readouterr()
    assert code in (BAD_INPUT, *accepted), (code, arguments, err)
    assert "Traceback" not in err + out, err
    if code == BAD_INPUT and sentences is not None:
        # on a slow machine it also says what it waits for
        said = [line for line in err.splitlines() if not line.startswith("Fuzzing ") and line != WAITING]
        assert 1 <= len(said) <= sentences, err
        assert all(map(is_sentence, said)), err
    return code


HUGE = {
    "deep list": "[" * 50_000,
    "deep mapping": "{a: " * 5_000 + "1" + "}" * 5_000,
    "deep block": "\n".join(" " * depth + "a:" for depth in range(400)),
    "laughs": "a: &a [x, x, x, x, x, x, x, x, x]\n"
    + "".join(f"{chr(98 + i)}: &{chr(98 + i)} [{', '.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(12)),
    "long integer": "seed: " + "9" * 20_000,
    "long text": "env: " + "x" * 90_000,
    "date": "seed: 2026-99-99",
    "sexagesimal": "budget: 1:30",
    "tag": "env: !!python/object/apply:os.system ['exit']",
    "binary": "env: !!binary '===='",
    "merge": "<<: 3",
    "anchors": "a: &a\n  <<: *a\n",
    "nul": "env: a\0b",
    "infinity": "time_limit: .inf",
    "not a number": "memory_limit: .nan",
    "null": "env: null",
    "list": "trust: [[[]]]",
    "keys": "? [a, b]\n: c",
    "int": "env: 0x" + "f" * 5_000,
}
VALUES = (
    None,
    True,
    -1,
    0,
    1e308,
    float("nan"),
    float("inf"),
    2**70,
    "",
    "x" * 1000,
    "\0",
    "../..",
    [],
    {},
    [[]],
    "1e400",
)


def scrambled(data, rng):
    """Bytes with a few of them changed, cut out, doubled, or cut off."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not data:
            return bytes(data)
        start = int(rng.integers(len(data)))
        size = int(rng.integers(1, 40))
        kind = rng.integers(6)
        if kind == 0:
            data[start] = rng.integers(256)
        elif kind == 1:
            del data[start : start + size]
        elif kind == 2:
            data[start:start] = data[start : start + size] * int(rng.integers(1, 4))
        elif kind == 3:
            data[start : start + size] = rng.bytes(size)
        elif kind == 4:
            del data[start:]
        else:
            data[start] ^= 1 << int(rng.integers(8))
    return bytes(data)


def mutated(value, rng):
    """A JSON value with one of its parts replaced, dropped, doubled or wrapped."""
    if isinstance(value, dict) and value and rng.random() < 0.85:
        key = list(value)[int(rng.integers(len(value)))]
        kind = rng.integers(4)
        if kind == 0:
            return {name: part for name, part in value.items() if name != key}
        if kind == 1:
            return {**value, str(rng.integers(100)): value[key]}
        return {**value, key: mutated(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.85:
        place = int(rng.integers(len(value)))
        if rng.random() < 0.2:
            return value[:place] + value[place + 1 :]
        return [*value[:place], mutated(value[place], rng), *value[place + 1 :]]
    return [VALUES[int(rng.integers(len(VALUES)))], [value], {"x": value}][int(rng.choice(3, p=[0.8, 0.1, 0.1]))]


def config_text(rng):
    """A campaign's file."""
    values = json.loads(json.dumps(yaml.safe_load(CampaignConfig(ads="constant", budget="1").to_yaml())))
    kind = rng.integers(3)
    if kind == 0:
        return scrambled(yaml.safe_dump(values).encode(), rng)
    if kind == 1:
        return yaml.safe_dump(mutated(values, rng)).encode()
    names = list(HUGE)
    text = HUGE[names[int(rng.integers(len(names)))]].encode()
    return text if rng.random() < 0.7 else scrambled(text, rng)


def scenario_text(rng, scenario):
    """A scenario as JSON."""
    if rng.random() < 0.4:
        return scrambled(scenario.to_json().encode(), rng)
    value = mutated(scenario.to_dict(), rng)
    if rng.random() < 0.05:
        return b"[" * 100_000
    return json.dumps(value).encode()


def make_run(folder, config):
    """A run folder of some executions, with failures."""
    store = Store.create(folder, config)
    for number in range(12):
        store.add(execution(number, ["collision"] if number % 3 == 0 else []))
    store.commit()
    store.close()


def broken_run(whole, folder, rng):
    """A copy of a run folder with something in it damaged or missing."""
    shutil.copytree(whole, folder)
    targets = [folder / DATABASE] * 6 + [folder / "config.yaml"] * 2 + list((folder / FAILURES).iterdir())[:1]
    target = targets[int(rng.integers(len(targets)))]
    kind = rng.integers(5)
    if kind == 0 and target.name != DATABASE:
        target.unlink()
    elif kind == 1:
        target.unlink()
        target.mkdir()
    elif kind == 2:
        target.write_bytes(rng.bytes(int(rng.integers(0, 5000))))
    else:
        target.write_bytes(scrambled(target.read_bytes(), rng))
    return folder


def network(rng):
    """An .npz file that claims to be a policy's."""
    buffer = io.BytesIO()
    kind = rng.integers(4)
    if kind == 0:
        np.savez_compressed(buffer, weights_0=np.ones((3, 4)), bias_0=np.ones(3), x=np.array(["a", "b"]))
        return scrambled(buffer.getvalue(), rng)
    if kind == 1:
        odd = [np.array(["a"]), np.ones((2, 2), dtype=complex), np.array(3), np.ones((0, 5)), np.zeros(3, "V8")]
        weights, bias = (odd[int(rng.integers(len(odd)))] for _ in range(2))
        np.savez(buffer, weights_0=weights, bias_0=bias)
        return buffer.getvalue()
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({10 ** int(rng.integers(6, 18))},), }}".encode()
    header += b" " * (63 - (len(header) + 10) % 64) + b"\n"
    array = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(64)
    if kind == 2:
        return bomb("weights_0.npy", "bias_0.npy")
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("weights_0.npy", array)
        file.writestr("bias_0.npy", array)
    return buffer.getvalue()


@cache
def bomb(large, small):
    """A small zip file that unpacks to 300 MB."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(large, bytes(300_000_000))
        file.writestr(small, b"x" * 300)
    return buffer.getvalue()


def model(rng):
    """A .zip file that claims to be a model of Stable-Baselines3."""
    buffer = io.BytesIO()
    data = {
        "policy_class": {":type:": "<class 'abc.ABCMeta'>", ":serialized:": "gAWVMAAAAAAAAACM"},
        "policy_kwargs": {},
        "observation_space": {":serialized:": "gASVA"},
        "action_space": 3,
    }
    kind = rng.integers(5)
    if kind == 1:
        return bomb("data", "policy.pth")
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("data", json.dumps(mutated(data, rng)) if kind else "[" * 100_000)
        file.writestr("policy.pth", rng.bytes(300))
        if kind == 2:
            file.writestr("../../escape.pth", b"x")
    return scrambled(buffer.getvalue(), rng) if kind == 4 else buffer.getvalue()


def zoo(folder, rng):
    """A run folder of rl-zoo3."""
    inside = folder / "model"
    inside.mkdir(parents=True)
    (folder / "model.zip").write_bytes(model(rng))
    names = list(HUGE)
    for name in ("args.yml", "config.yml"):
        (inside / name).write_text(HUGE[names[int(rng.integers(len(names)))]])
    if rng.random() < 0.5:
        (inside / "vecnormalize.pkl").write_bytes(scrambled(b"\x80\x04\x95" + rng.bytes(60) + b".", rng))
    return folder


FLAGS = ("--env", "--ads", "--method", "--config", "--budget", "--seed", "--batch", "--trust", "--resume", "--workers")
WORDS = (
    "", "-", "--", "0",
    "-1", "1e9", "nan", "9" * 5000, "\0", "\udcff", "x" * 10_000, "constant", "constant:", "constant:nan",
    "constant:1e999", "rule:", "rule:x", ":", "::", "os:system", "a.b.c:d", ".:x", "..:x", "/", ".", "~", "/dev/null",
    "/proc/self/mem", "lane-follow",
    "behavexplor/x-v0", "x-v999999999999", "sha256:",
    "1h1h", "0s", "1e3s", "99999999999999h",
    "[red]", "%s%n", "uniform", "tests.drivers:cruiser.__class__", "--help=1", "pyproject.toml", "configs",
)  # fmt: skip


def flags(rng):
    """Flags of `fuzz`, most of them wrong."""
    chosen = []
    for _ in range(int(rng.integers(1, 4))):
        chosen += [FLAGS[int(rng.integers(len(FLAGS)))], WORDS[int(rng.integers(len(WORDS)))]]
    return chosen[: None if rng.random() < 0.9 else -1]


def write(path, data):
    path.parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_bytes(data)
    return path
