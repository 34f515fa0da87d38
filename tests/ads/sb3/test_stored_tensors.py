"""Tensors inside of pickles, as models of ARS have one: they are not suspected, and what they could hide is named."""

import base64
import io
import pickle

import pytest
import torch

from behavexplor.ads.sb3.archive import read_archive, suspicions_about
from behavexplor.ads.sb3.inert import LOAD_TENSOR, OLD_TORCH, read_pickle
from tests.ads.sb3.models import Payload, make_model
from tests.ads.sb3.test_policy import with_data

OTHER = f"it calls {LOAD_TENSOR} with other things than a tensor, which was not run"


class Loading:
    """Lets torch load a file when it is unpickled."""

    def __init__(self, content):
        self.content = content

    def __reduce__(self):
        return torch.storage._load_from_bytes, (self.content,)


def stored(value):
    file = io.BytesIO()
    torch.save(value, file, _use_new_zipfile_serialization=False)
    return file.getvalue()


def said_about(value, protocol=5):
    return suspicions_about("it", read_pickle(pickle.dumps(value, protocol))[1])


def test_a_model_of_ars_is_not_suspected(tmp_path):
    make_model("ARS").save(tmp_path / "model")
    assert read_archive(tmp_path / "model.zip").suspicions == ()


@pytest.mark.parametrize("tensor", [torch.ones(3), torch.ones(2, dtype=torch.int64), torch.ones(2, dtype=torch.bool)])
def test_a_tensor_is_not_suspected(tensor):
    assert said_about(tensor) == []


def test_a_payload_in_place_of_a_tensor_does_nothing_and_is_named(tmp_path):
    make_model("ARS").save(tmp_path / "model")
    poisoned = pickle.dumps(Loading(stored(Payload(tmp_path / "proof"))))
    value = base64.b64encode(poisoned).decode()
    found = read_archive(with_data(tmp_path / "model.zip", tmp_path / "poisoned.zip", {"weights": value})).suspicions
    assert "'weights' of its data calls posix.mkdir, which was not run" in found
    assert not (tmp_path / "proof").exists()


def test_a_payload_that_is_loaded_beside_a_tensor_is_named(tmp_path):
    hidden = pickle.dumps(Loading(stored(Payload(tmp_path / "proof"))), 5)[:-1] + b"0"  # its value is dropped
    tensor = pickle.dumps(torch.ones(3), 5)
    assert any("posix.mkdir" in said for said in suspicions_about("it", read_pickle(hidden + tensor)[1]))


def test_what_a_frame_would_hide_is_not_taken_for_a_tensor():
    pickles = [pickle.dumps(value, 4) for value in (1001, {}, ["a" * 9], [])]
    assert OTHER in said_about(Loading(OLD_TORCH + b"".join(pickles)))


@pytest.mark.parametrize(
    "content",
    [b"", b"PK\x03\x04", OLD_TORCH, OLD_TORCH + b"rubbish", stored(Loading(stored(torch.ones(2)))), "text"],
    ids=["nothing", "zip", "short", "rubbish", "nested", "text"],
)
def test_what_torch_would_read_otherwise_is_named(content):
    assert OTHER in said_about(Loading(content))


def test_a_function_that_is_given_to_others_is_named():
    assert said_about([torch.storage._load_from_bytes, Payload("proof")])[0].startswith("it calls posix.mkdir")
    names = read_pickle(pickle.dumps([torch.storage._load_from_bytes, dict]))[1]
    assert f"it calls {LOAD_TENSOR}, which was not run" in suspicions_about("it", names)
