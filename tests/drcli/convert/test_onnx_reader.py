"""ONNX files of other programs, whole and damaged, as frozen graphs."""

import numpy as np
import pytest

from drcli.base.errors import SettingsError
from drcli.convert.onnx_reader import read_onnx
from drcli.convert.tensorflow.interpreter import Graph

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")
helper = onnx.helper
FLOAT = onnx.TensorProto.FLOAT


def onnx_file(nodes, weights, shape=("n", 1, 8, 10)):
    graph = helper.make_graph(
        nodes,
        "g",
        [helper.make_tensor_value_info("picture", FLOAT, shape)],
        [helper.make_tensor_value_info("policy", FLOAT, ["n", 3])],
        [onnx.numpy_helper.from_array(array, name) for name, array in weights.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    return model.SerializeToString()


def channels_first():
    """A policy as PyTorch's exporter writes it: channels first, Gemm, flattened channels first."""
    random = np.random.default_rng(1)
    weights = {
        "scale": np.array(255.0, np.float32),
        "conv.weight": random.normal(size=(2, 1, 3, 3)).astype(np.float32),
        "conv.bias": random.normal(size=2).astype(np.float32),
        "width": np.array([-1, 2 * 3 * 4], np.int64),
        "fc.weight": random.normal(size=(3, 24)).astype(np.float32),
        "fc.bias": random.normal(size=3).astype(np.float32),
    }
    nodes = [
        helper.make_node("Div", ["picture", "scale"], ["scaled"]),
        helper.make_node("Conv", ["scaled", "conv.weight", "conv.bias"], ["conv"], strides=[2, 2]),
        helper.make_node("Relu", ["conv"], ["relu"]),
        helper.make_node("Reshape", ["relu", "width"], ["flat"]),
        helper.make_node("Gemm", ["flat", "fc.weight", "fc.bias"], ["logits"], transB=1),
        helper.make_node("Softmax", ["logits"], ["policy"], axis=1),
    ]
    return nodes, weights


def test_a_policy_with_its_channels_first_computes_the_same():
    data = onnx_file(*channels_first())
    pictures = np.random.default_rng(0).integers(0, 256, (4, 1, 8, 10)).astype(np.float32)

    graph = Graph(read_onnx(data, "policy.onnx"), "policy.onnx")

    assert graph.inputs == {"picture": (-1, 1, 8, 10)}
    wanted = onnxruntime.InferenceSession(data).run(None, {"picture": pictures})[0]
    np.testing.assert_allclose(graph.run({"picture": pictures}), wanted, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda n, w: n[4].attribute.append(helper.make_attribute("alpha", 2.0)), "Gemm of logits"),
        (
            lambda n, w: n[1].attribute.append(helper.make_attribute("auto_pad", "SAME_LOWER")),
            "padding",
        ),
        (lambda n, w: w.update(width=np.array([-1, 3, 8], np.int64)), "Reshape of flat"),
        (lambda n, w: setattr(n[2], "op_type", "Erf"), "operation Erf, which no policy needs"),
    ],
)
def test_what_no_policy_has_is_refused(change, why):
    nodes, weights = channels_first()
    change(nodes, weights)

    with pytest.raises(SettingsError, match=why) as caught:
        read_onnx(onnx_file(nodes, weights), "policy.onnx")

    assert str(caught.value).startswith("policy.onnx ")


def test_a_damaged_file_is_refused_wherever_it_ends():
    data = onnx_file(*channels_first())

    for length in (0, 1, 10, len(data) // 2, len(data) - 1):
        with pytest.raises(SettingsError, match=r"policy\.onnx (is|has|takes)"):
            read_onnx(data[:length], "policy.onnx")


def test_weights_in_other_files_are_not_followed():
    model = onnx.load_model_from_string(onnx_file(*channels_first()))
    tensor = model.graph.initializer[1]
    onnx.external_data_helper.set_external_data(tensor, location="../../etc/passwd")
    tensor.ClearField("raw_data")

    with pytest.raises(SettingsError, match="keeps its weights in other files"):
        read_onnx(model.SerializeToString(), "policy.onnx")
