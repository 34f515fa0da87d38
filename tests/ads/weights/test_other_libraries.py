"""The drivers that docs/policies.md shows for other libraries, where these are installed."""

from importlib import import_module
from types import ModuleType

import gymnasium
import numpy as np
import pytest
import torch

from behavexplor.ads.weights.weights_policy import load_weights
from behavexplor.execution.simulation import Simulation
from tests.ads.weights.files import KINEMATICS, META
from tests.pages.blocks import ROOT, blocks_of


def shown_in(file, name):
    """The class or function in a block of the page."""
    (block,) = [one for one in blocks_of(ROOT / "docs" / "policies.md") if one.file == file]
    page = ModuleType(file)
    exec(block.text, page.__dict__)
    return getattr(page, name)


def drives(env, driver):
    """Drive a scenario, and return how many decisions it had."""
    simulation = Simulation(env, driver)
    return len(simulation.run(simulation.logical.sample(np.random.default_rng(0))).time)


def test_an_onnx_file_drives_as_its_network(tmp_path, monkeypatch):
    onnx, _ = pytest.importorskip("onnx"), pytest.importorskip("onnxruntime")
    monkeypatch.chdir(tmp_path)
    layer = torch.nn.Linear(30, 5)
    weights = {"weight": layer.weight.detach().numpy(), "bias": layer.bias.detach().numpy()}
    make = onnx.helper
    nodes = [
        make.make_node("Flatten", ["obs"], ["flat"]),
        make.make_node("Gemm", ["flat", "weight", "bias"], ["logits"], transB=1),
    ]
    shapes = [
        make.make_tensor_value_info(name, 1, shape) for name, shape in (("obs", ["n", 6, 5]), ("logits", ["n", 5]))
    ]
    arrays = [onnx.numpy_helper.from_array(array, name) for name, array in weights.items()]
    graph = make.make_graph(nodes, "policy", shapes[:1], shapes[1:], arrays)
    made = make.make_model(graph, opset_imports=[make.make_opsetid("", 17)])
    made.ir_version = 9
    onnx.save(made, "policy.onnx")
    driver = shown_in("my_model.py", "Model")()
    seen = np.random.default_rng(0).normal(size=(1000, 6, 5)).astype(np.float32)
    with torch.no_grad():
        expected = layer(torch.from_numpy(seen).flatten(1)).argmax(1).numpy()
    np.testing.assert_array_equal(driver.predict(seen)[0], expected)
    assert drives("lane-change", driver) > 1


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_checkpoint_of_rllib_drives(tmp_path, monkeypatch):
    pytest.importorskip("ray.rllib")
    ppo = import_module("ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module")
    monkeypatch.chdir(tmp_path)
    box = gymnasium.spaces.Box(-np.inf, np.inf, (25,), np.float32)
    module = ppo.DefaultPPOTorchRLModule(observation_space=box, action_space=META, model_config={"fcnet_hiddens": [16]})
    folder = tmp_path / "checkpoint/learner_group/learner/rl_module/default_policy"
    module.save_to_path(folder)
    driver = shown_in("my_rllib.py", "Checkpoint")()
    assert drives("highway-fast-v0", driver) > 1


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_model_of_keras_becomes_a_file_of_weights(tmp_path, monkeypatch):
    monkeypatch.setenv("KERAS_BACKEND", "torch")
    keras = pytest.importorskip("keras")
    widths = [
        keras.layers.Dense(32, activation="tanh"),
        keras.layers.Dense(32, activation="tanh"),
        keras.layers.Dense(5),
    ]
    model = keras.Sequential([keras.Input((5, 5)), keras.layers.Flatten(), *widths])
    shown_in("from_keras.py", "write_weights")(model, tmp_path / "weights.safetensors")
    seen = np.random.default_rng(0).normal(size=(1000, 5, 5)).astype(np.float32)
    expected = np.asarray(model.predict(seen, verbose=0)).argmax(axis=1)
    found = load_weights(tmp_path / "weights.safetensors", "tanh").seeing(KINEMATICS, META).predict(seen)[0]
    np.testing.assert_array_equal(found, expected)
