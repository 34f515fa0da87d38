"""Files of weights that cannot drive are refused in one true sentence, and hostile ones quickly and without effect."""

import json
import os
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import safetensors.torch
import torch
from torch import nn

import behavexplor
from behavexplor.ads.learned.network_file import TrainedNetwork, read_network, write_network
from behavexplor.ads.loading import load_ads
from behavexplor.ads.sb3.archive import read_archive
from behavexplor.ads.sb3.model_in_memory import policy_of
from behavexplor.ads.sb3.policy import load_policy
from behavexplor.ads.weights.tensors import MAX_BYTES, read_tensors
from behavexplor.ads.weights.weights_policy import load_weights
from behavexplor.errors import LONGEST, InputError
from behavexplor.execution.simulation import Simulation
from tests.ads.sb3.models import Payload, make_model
from tests.ads.weights.files import COMMANDS, FORMS, GRID, KINEMATICS, META, Tutorial, dense, write
from tests.fakes import LOGICAL


class Recurrent(nn.Module):
    def __init__(self):
        super().__init__()
        self.lstm, self.head = nn.LSTM(25, 64), dense(64, 64, 5)


class Normalized(nn.Module):
    def __init__(self):
        super().__init__()
        self.fc1, self.norm, self.fc2 = nn.Linear(25, 64), nn.LayerNorm(64), nn.Linear(64, 5)


def nested():
    """A layer with another one inside of it."""
    network = nn.Module()
    network.fc = nn.Linear(25, 5)
    network.fc.lora = nn.Linear(25, 4)
    return network.state_dict()


def two():
    return {"first": dense(25, 64, 5).state_dict(), "second": dense(25, 64, 5).state_dict()}


def noisy(inputs, outputs):
    """The weights of a noisy layer (Fortunato et al., 2018), as scripts of Rainbow name them."""
    return {f"fc.weight_{name}": torch.zeros(outputs, inputs) for name in ("mu", "sigma", "epsilon")}


UNUSABLE = {
    "module": (
        Tutorial,
        r"holds a whole pickled module \(tests\.ads\.weights\.files\.Tutorial\), whose code is not run: ",
    ),
    "no tensors": (lambda: {"episode": 3, "rewards": [1.0]}, r"holds no tensors of a network: save its weights by "),
    "recurrent": (lambda: Recurrent().state_dict(), r"has recurrent layers, and only dense and convolutional"),
    "attention": (lambda: nn.MultiheadAttention(8, 2).state_dict(), r"has attention layers, and only dense"),
    "normalizing": (lambda: Normalized().state_dict(), r"has normalizing layers, and only dense"),
    "apart": (
        lambda: {"a.weight": torch.zeros(64, 25), "b.weight": torch.zeros(5, 32)},
        r"has layers that do not follow one another \(a 25-64, b 32-5\)",
    ),
    "nested": (nested, r"has layers that do not follow one another \(fc 25-5, fc\.lora 25-4\)"),
    "scalar": (lambda: {"temperature.weight": torch.tensor(1.0)}, "has 0-dimensional layers, and only dense"),
    "empty": (
        lambda: {"a.weight": torch.zeros(0, 25), "b.weight": torch.zeros(5, 0)},
        r"has layers that do not follow one another \(a 25-0, b 0-5\)",
    ),
    "unmatched": (lambda: {"a.weight": torch.zeros(5, 25), "a.bias": torch.zeros(4)}, "has unmatched layers, and only"),
    "noisy": (lambda: noisy(25, 64) | {"head.weight": torch.zeros(5, 64)}, "has noisy layers, and only dense"),
    "reparametrized": (
        lambda: nn.Sequential(nn.utils.parametrizations.weight_norm(nn.Linear(25, 64)), nn.Linear(64, 5)).state_dict(),
        "has reparametrized layers, and only dense",
    ),
    "running": (
        lambda: nn.Sequential(nn.Linear(25, 64), nn.BatchNorm1d(64, affine=False), nn.Linear(64, 5)).state_dict(),
        "has normalizing layers, and only dense",
    ),
    "signals": (lambda: nn.Conv1d(5, 8, 3).state_dict(), "has one- or three-dimensional convolutional layers, and"),
    "two": (two, r"has the networks first \(25-64-5\), second \(25-64-5\): name the one that acts as `network: first`"),
    "silent": (
        lambda: Tutorial().state_dict(),
        r"has the layers 25-128-128-5, but .*: add `activation: relu` \(or tanh,",
    ),
    "convolutional": (lambda: FORMS["convolutional"].network().state_dict(), r"dense 256-64-5.*`strides: \[1, 1\]`"),
}


def with_first(first):
    """A network whose last layer alone could drive, too; with the first layer in another form."""
    return dense(25, 25, 5).state_dict() | {"0.weight": first}


def quantized(rows):
    return torch.quantize_per_tensor(torch.ones(rows, 25), 0.1, 0, torch.qint8)


OTHER_FORMS = {
    "quantized": (lambda: with_first(quantized(25)), "quantized"),
    "a parameter": (lambda: with_first(nn.Parameter(quantized(25), requires_grad=False)), "quantized"),
    "packed": (lambda: with_first((quantized(25), torch.zeros(25))), "quantized"),
    "sparse": (lambda: with_first(torch.ones(25, 25).to_sparse()), "sparse"),
    "sparse rows": (lambda: with_first(torch.ones(25, 25).to_sparse_csr()), "sparse"),
    "without numbers": (lambda: with_first(torch.empty(25, 25, device="meta")), "without numbers, on the device meta"),
    "complex": (lambda: with_first(torch.ones(25, 25, dtype=torch.complex64)), "of the type ComplexFloat"),
    "eight bits": (lambda: with_first(torch.ones(25, 25).to(torch.float8_e4m3fn)), r"of the type torch\.float8_e4m3fn"),
    "whole numbers": (lambda: with_first(torch.ones(25, 25, dtype=torch.int8)), "of the type Char"),
}


@pytest.mark.filterwarnings("ignore:Sparse CSR|torch.quantize_per_tensor|torch.ao.quantization")
@pytest.mark.parametrize("name", OTHER_FORMS)
def test_no_network_drives_without_a_layer_that_cannot_be_read(name, tmp_path):
    made, form = OTHER_FORMS[name]
    torch.save({"model": made()}, tmp_path / "weights.pth")
    cure = "only dense floats are read: save a copy of its weights as dense tensors of torch.float32"
    with pytest.raises(InputError, match=rf"has the tensor 'model\.0\.weight', which is {form}, and {cure}"):
        load_weights(tmp_path / "weights.pth", "relu")


@pytest.mark.parametrize("kind", [torch.int8, torch.float8_e4m3fn, torch.complex64])
@pytest.mark.parametrize("name", ["0.weight", "0.bias"])
def test_nor_does_one_of_safetensors(kind, name, tmp_path):
    network = dense(25, 25, 5).state_dict() | {"steps": torch.tensor(3)}
    safetensors.torch.save_file(network, tmp_path / "weights.safetensors")
    assert str(load_weights(tmp_path / "weights.safetensors", "relu").network) == "25-25-5"
    safetensors.torch.save_file(network | {name: network[name].to(kind)}, tmp_path / "weights.safetensors")
    with pytest.raises(InputError, match=rf"has the tensor '{name}', which is of the type \w+, and only dense floats"):
        load_weights(tmp_path / "weights.safetensors", "relu")


def test_layers_may_have_numbers_of_any_kind_in_their_names(tmp_path):
    layers = {"²10.weight": torch.zeros(5, 64), "²9.weight": torch.zeros(64, 25)}
    safetensors.torch.save_file(layers, tmp_path / "weights.safetensors")
    assert str(load_weights(tmp_path / "weights.safetensors", "relu").network) == "25-64-5"


@pytest.mark.parametrize("name", UNUSABLE)
def test_an_unusable_file_is_refused_in_one_sentence(name, tmp_path):
    made, message = UNUSABLE[name]
    torch.save(made(), tmp_path / "weights.pth")
    with pytest.raises(InputError, match=message) as caught:
        load_weights(tmp_path / "weights.pth")
    assert len(str(caught.value)) < LONGEST


DIVERGED = "has weights that are NaN or infinite, as after a training that diverged: give an earlier one"


@pytest.mark.parametrize("name", ["0.weight", "0.bias", "2.weight", "2.bias", "log_std"])
def test_weights_that_diverged_are_refused_in_each_layer(name, tmp_path):
    state = dense(25, 64, 5).double().state_dict() | {"log_std": torch.zeros(5, dtype=torch.float64)}
    for number in (float("nan"), float("inf"), -1e300):  # the last is infinite in the type by which a policy decides
        state[name].view(-1)[-1] = number
        torch.save(state, tmp_path / "weights.pth")
        safetensors.torch.save_file(state, tmp_path / "weights.safetensors")
        for suffix in ("pth", "safetensors"):
            with pytest.raises(InputError, match=rf"weights\.{suffix} {DIVERGED}"):
                load_weights(tmp_path / f"weights.{suffix}", "relu")


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_other_policies_that_diverged_are_refused(number, tmp_path):
    model = make_model("DQN", KINEMATICS)
    list(model.policy.parameters())[-1].data[-1] = number
    model.save(tmp_path / "model.zip")
    with pytest.raises(InputError, match=rf"model\.zip {DIVERGED}"):
        load_policy(tmp_path / "model.zip")
    with pytest.raises(InputError, match=rf"model\.zip {DIVERGED}"):
        load_policy(tmp_path / "model.zip", [read_archive(tmp_path / "model.zip").digest])
    with pytest.raises(InputError, match=rf"The model {DIVERGED}"):
        policy_of(model)
    biases = np.array([0.0, number])
    write_network(tmp_path / "policy.npz", TrainedNetwork([(np.zeros((2, 3)), biases)]))
    with pytest.raises(InputError, match=rf"policy\.npz {DIVERGED}"):
        read_network(tmp_path / "policy.npz")


def test_what_no_layer_uses_is_said(tmp_path, caplog):
    statistics = {"obs_mean": torch.zeros(25), "obs_std": torch.ones(1, 25), "rewards": torch.zeros(100)}
    torch.save(dense(25, 64, 5).state_dict() | statistics, tmp_path / "weights.pth")
    load_weights(tmp_path / "weights.pth", "relu")
    assert "weights.pth also has obs_mean, obs_std, which no layer uses: if its script changes" in caplog.text
    caplog.clear()
    torch.save(dense(25, 25, 25).state_dict(), tmp_path / "weights.pth")  # biases and weights as long as observations
    load_weights(tmp_path / "weights.pth", "relu")
    assert "which no layer uses" not in caplog.text


@pytest.mark.parametrize(
    ("name", "what"),
    [("q.h5", "a model of Keras: write its weights"), ("q.keras", "a model of Keras"), ("q.onnx", "a program of ONNX")],
)
def test_files_of_other_libraries_are_named_with_the_way_out(name, what, tmp_path):
    (tmp_path / name).write_bytes(b"\x89HDF")
    with pytest.raises(InputError, match=rf"{name} is {what}.* \(docs/policies.md\)"):
        load_ads(str(tmp_path / name), None)


def test_a_pointer_of_git_lfs_is_named(tmp_path):
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
    for name in ("weights.pth", "weights.safetensors", "model.zip", "policy.npz"):
        (tmp_path / name).write_text(pointer)
        with pytest.raises(InputError, match=rf"{name} only says where Git LFS has the file: fetch it by `git lfs"):
            load_ads(str(tmp_path / name), LOGICAL.roadmap)


def test_the_settings_choose_the_network(tmp_path):
    torch.save(two(), tmp_path / "weights.pth")
    (tmp_path / "weights.yaml").write_text("{network: second, activation: tanh}")
    assert load_weights(tmp_path / "weights.pth").network.name == "second"
    (tmp_path / "weights.yaml").write_text("{network: third, activation: tanh}")
    with pytest.raises(InputError, match="name the one that acts"):
        load_weights(tmp_path / "weights.pth")


def test_formats_that_are_not_read_are_named(tmp_path):
    path = tmp_path / "weights.pth"
    torch.save(Tutorial().state_dict(), path, _use_new_zipfile_serialization=False)
    with pytest.raises(InputError, match=r"has the format of torch before 1\.6, which is not read: load it with"):
        read_tensors(path)
    with pytest.warns((DeprecationWarning, FutureWarning), match="TorchScript|torch.jit"):
        torch.jit.script(dense(25, 64, 5)).save(path)
    with pytest.raises(InputError, match="is a program of TorchScript, which is not run"):
        read_tensors(path)
    path.write_bytes(pickle.dumps({"a": 1}))
    with pytest.raises(InputError, match="is not a file that torch"):
        read_tensors(path)
    safetensors.torch.save_file({"a": torch.zeros(3, dtype=torch.int64)}, tmp_path / "a.safetensors")
    with pytest.raises(InputError, match="holds no tensors of a network"):
        read_tensors(tmp_path / "a.safetensors")


def test_types_of_numbers_are_those_of_torch(tmp_path):
    network = Tutorial()
    for kind in (torch.float64, torch.float16, torch.bfloat16):
        state = {name: array.to(kind) for name, array in network.state_dict().items()}
        state["layer1.weight"] = state["layer1.weight"].t().contiguous().t()  # not in the order of its rows
        torch.save(state, tmp_path / "weights.pth")
        safetensors.torch.save_file({k: v.contiguous() for k, v in state.items()}, tmp_path / "weights.safetensors")
        for suffix in ("pth", "safetensors"):
            arrays = read_tensors(tmp_path / f"weights.{suffix}").arrays
            assert arrays.keys() == state.keys()
            for name, array in arrays.items():
                np.testing.assert_array_equal(array.astype(np.float64), state[name].double().numpy())


def test_shapes_that_fit_nothing_are_shown_with_a_way_out(tmp_path):
    torch.save(dense(23, 64, 5).state_dict(), tmp_path / "weights.pth")
    with pytest.raises(InputError, match=r"observes Box\(23,\) and commands Discrete\(5\), but .* Give highway-env's"):
        Simulation("highway-fast-v0", str(tmp_path / "weights.pth"), activation="relu")
    torch.save(dense(35, 64, 5).state_dict(), tmp_path / "weights.pth")
    with pytest.raises(InputError, match=r"vehicles_count: 7, features: \[presence, x, y, vx, vy\]"):
        Simulation("highway-fast-v0", str(tmp_path / "weights.pth"), activation="relu")


def test_continuous_actions_need_the_squash(tmp_path):
    path, _ = write(FORMS["soft"], tmp_path)
    path.with_suffix(".yaml").write_text("activation: relu")
    with pytest.raises(InputError, match="add `squash: true` if tanh follows its last layer, or else `false`"):
        load_weights(path).seeing(KINEMATICS, COMMANDS)


def test_a_gaussian_actor_does_not_choose_among_actions(tmp_path):
    path, _ = write(FORMS["gaussian"], tmp_path)
    path.with_suffix(".yaml").write_text("{activation: tanh, config: {}}")
    with pytest.raises(InputError, match=r"commands Box\(2,\), but .* action: \{type: ContinuousAction\}"):
        Simulation("highway-fast-v0", str(path))


def test_convolutions_must_fit_the_grid(tmp_path):
    path, _ = write(FORMS["convolutional"], tmp_path)
    policy = load_weights(path)
    with pytest.raises(InputError, match=r"for grids with 4 channels of floats, but .* have the shape \(5, 5\)"):
        policy.seeing(KINEMATICS, META)
    larger = gymnasium.spaces.Box(-1, 1, (4, 15, 15), np.float32)
    with pytest.raises(InputError, match=r"make \(16, 6, 6\) of observations .* takes 256 numbers: correct `strides`"):
        policy.seeing(larger, META)
    policy.seeing(GRID, META)


def hostile_pickle(path, proof):
    torch.save({"a": torch.zeros(2, 2), "b": Payload(proof)}, path)


def bomb(path, _):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file, file.open("archive/data.pkl", "w") as member:
        for _ in range(900):
            member.write(bytes(1_000_000))


def many(path, _):
    with zipfile.ZipFile(path, "w") as file:
        for i in range(30_000):
            file.writestr(str(i), b"")


def long_header(path, _):
    path = path.with_suffix(".safetensors")
    header = b'{"a":' + b"[" * 20_000_000
    path.write_bytes(len(header).to_bytes(8, "little") + header)
    return path


def declared(path, _):
    header = json.dumps({"a": {"dtype": "F32", "shape": [500_000_000], "data_offsets": [0, 2_000_000_000]}}).encode()
    path.with_suffix(".safetensors").write_bytes(len(header).to_bytes(8, "little") + header)
    return path.with_suffix(".safetensors")


def nothing(path, _):
    """A tensor without numbers, whose shape is too large for an array."""
    header = json.dumps({"a": {"dtype": "F64", "shape": [5, 25, 0, 10**18], "data_offsets": [0, 0]}}).encode()
    path.with_suffix(".safetensors").write_bytes(len(header).to_bytes(8, "little") + header)
    return path.with_suffix(".safetensors")


def nothing_of_torch(path, _):
    torch.save({"a.weight": torch.zeros(5, 25, 0, 10**17)}, path)


def nothing_of_numpy(path, _):
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (5, 25, 0, 1000000000000000000)}\n"
    content = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with zipfile.ZipFile(path.with_suffix(".npz"), "w") as file:
        file.writestr("weights_0.npy", content)
    return path.with_suffix(".npz")


def huge(path, _):
    with path.open("wb") as file:
        file.truncate(2_000_000_000)


def beyond(path, _):
    """A tensor whose shape has more numbers than its storage."""
    torch.save({"a.weight": torch.zeros(100, 100)}, path)
    with zipfile.ZipFile(path) as file:
        members = {name: file.read(name) for name in file.namelist()}
    content = members["weights/data.pkl"]
    assert content.count(b"KdKd\x86") == 1
    members["weights/data.pkl"] = content.replace(b"KdKd\x86", b"K\xffK\xff\x86")
    with zipfile.ZipFile(path, "w") as file:
        for name, data in members.items():
            file.writestr(name, data)


def endless(path, _):
    path.symlink_to("/dev/zero")


def loop(path, _):
    path.symlink_to(path)


def pipe(path, _):
    os.mkfifo(path)


HOSTILE = {
    hostile_pickle: "no network|does not|has no layers",
    bomb: "would unpack to 900000000 bytes, which torch never writes",
    many: "has more than 20000 members, which no policy needs",
    long_header: "has a header that no policy needs",
    declared: "is not a file of safetensors, or is damaged",
    nothing: "is not a file of safetensors, or is damaged",
    nothing_of_torch: "is not a file that torch.save writes, or is damaged",
    nothing_of_numpy: "contains no network of this package",
    huge: f"has more than {MAX_BYTES} bytes, which are not read",
    beyond: "a tensor in it has more numbers than the file",
    endless: "is not a regular file",
    loop: "no file or folder|cannot be read|symbolic links",
    pipe: "is not a regular file",
}
_PROGRAM = r"""
import re, sys, time
from pathlib import Path
from behavexplor.commands.inspect import contents_of
from behavexplor.errors import InputError
began = time.process_time()
try:
    print(contents_of(sys.argv[1]).facts)
except InputError as error:
    print(error)
status = Path("/proc/self/status")
most = re.search(r"VmHWM:\s+(\d+)", status.read_text())[1] if status.exists() else 0
print(time.process_time() - began, int(most) / 1e6)
"""


@pytest.mark.parametrize("make", HOSTILE)
def test_a_hostile_file_is_refused_at_once_and_has_no_effect(make, tmp_path):
    path, proof = tmp_path / "weights.pth", tmp_path / "proof"
    path = make(path, proof) or path
    env = {**os.environ, "PYTHONPATH": str(Path(behavexplor.__file__).parents[1])}
    ended = subprocess.run(
        [sys.executable, "-c", _PROGRAM, str(path)], capture_output=True, text=True, timeout=60, check=True, env=env
    )
    *said, measured = ended.stdout.strip().splitlines()
    seconds, gigabytes = map(float, measured.split())
    assert make is hostile_pickle or any(part in said[0] for part in HOSTILE[make].split("|")), said
    assert seconds < 1.0
    assert gigabytes < 1.0
    assert not proof.exists()
    if make is hostile_pickle:
        assert "mkdir" in said[0]
        assert "which was not run" in said[0]
        with pytest.raises(InputError):
            load_weights(path)
    else:
        with pytest.raises((InputError, OSError)):
            load_weights(path, "relu")


def test_damaged_files_are_refused(tmp_path):
    path, _ = write(FORMS["tutorial"], tmp_path)
    content = path.read_bytes()
    generator = np.random.default_rng(5)
    for _ in range(200):
        damaged = bytearray(content)
        for place in generator.integers(0, len(content), 3):
            damaged[place] ^= int(generator.integers(1, 256))
        path.write_bytes(bytes(damaged[: generator.integers(1, len(content))] if generator.random() < 0.3 else damaged))
        try:
            load_weights(path)
        except InputError as error:
            assert str(error)


def test_code_beside_a_network_is_named_and_not_run(tmp_path, caplog):
    torch.save({"model": Tutorial().state_dict(), "b": Payload(tmp_path / "proof")}, tmp_path / "weights.pth")
    load_weights(tmp_path / "weights.pth", "relu").seeing(KINEMATICS, META)
    assert "its pickle calls posix.mkdir, which was not run" in caplog.text
    assert not (tmp_path / "proof").exists()


def test_damaged_pickles_are_refused(tmp_path):
    path, _ = write(FORMS["checkpoint"], tmp_path)
    with zipfile.ZipFile(path) as file:
        members = {name: file.read(name) for name in file.namelist()}
    (name,) = [one for one in members if one.endswith("data.pkl")]
    generator = np.random.default_rng(6)
    for _ in range(150):
        damaged = bytearray(members[name])
        for place in generator.integers(0, len(damaged), 2):
            damaged[place] = int(generator.integers(256))
        with zipfile.ZipFile(path, "w") as file:
            for one, data in members.items():
                file.writestr(one, bytes(damaged) if one == name else data)
        try:
            load_weights(path).seeing(KINEMATICS, META)
        except InputError as error:
            assert len(str(error)) <= LONGEST
