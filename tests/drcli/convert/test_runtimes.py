"""One policy in every engine, and files of strangers in theirs."""

import subprocess
import sys

import numpy as np
import pytest

from drcli.base.errors import NotAvailable, SettingsError
from drcli.convert.policy_file import PolicyFile, read_policy_file
from drcli.convert.runtimes import check_file, policy_of_file, policy_of_model
from drcli.learn.policy import Observation, decide
from drcli.transfer import export_forms as forms
from small_policies import metadata_json, small_metadata, small_network

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
helper = onnx.helper
ENGINES = ["pb", "onnx", "openvino"]
FLOAT, UINT8, INT64 = (getattr(onnx.TensorProto, kind) for kind in ("FLOAT", "UINT8", "INT64"))


@pytest.mark.parametrize("runtime", ENGINES)
@pytest.mark.parametrize(
    ("head", "sensors", "stack"),
    [
        ("discrete", ["FRONT_FACING_CAMERA"], 1),
        ("discrete", ["observation"], 3),
        ("continuous", ["STEREO_CAMERAS", "LIDAR"], 1),
        ("sac", ["LEFT_CAMERA", "DISCRETIZED_SECTOR_LIDAR"], 2),
    ],
)
def test_every_engine_drives_as_pytorch_does(runtime, head, sensors, stack):
    pytest.importorskip("openvino" if runtime == "openvino" else "onnx")
    metadata = small_metadata(head, sensor=sensors)
    model = small_network(metadata, stack=stack)
    frames, scans = forms.sample_inputs(model.spec, 12)

    policy = policy_of_model(model, metadata, runtime, "the model")
    found = forms.compare(model, policy, frames, scans)

    assert policy.spec == model.spec
    assert found.same_actions == 1.0
    assert found.greatest_difference < (1e-5 if runtime == "pb" else 1e-4)


def test_pytorch_stays_the_network_itself():
    metadata = small_metadata()
    model = small_network(metadata)

    assert policy_of_model(model, metadata, "torch", "the model") is model


def test_actions_are_the_likeliest_or_drawn_from_the_probabilities():
    metadata = small_metadata()
    model = small_network(metadata)
    policy = policy_of_model(model, metadata, "pb", "the model")
    frames, scans = forms.sample_inputs(model.spec, 8)
    seen = Observation.of_arrays(frames, scans, np.empty((8, 0), np.float32))
    noise = np.random.default_rng(2).random((8, 2), np.float32)
    best = np.arange(8) < 4

    ours, theirs = (decide(each, seen, noise, best) for each in (model, policy))
    greedy = [decide(each, seen, noise, ~best & best, 0.5) for each in (model, policy)]

    np.testing.assert_array_equal(ours.actions, theirs.actions)
    np.testing.assert_allclose(ours.log_probs, theirs.log_probs, atol=1e-4)
    np.testing.assert_array_equal(greedy[0].actions, greedy[1].actions)
    assert theirs.values.tolist() == [0.0] * 8


def test_continuous_actions_cannot_be_drawn_from_a_graph():
    metadata = small_metadata("continuous")
    model = small_network(metadata)
    policy = policy_of_model(model, metadata, "pb", "the model")
    frames, scans = forms.sample_inputs(model.spec, 2)
    seen = Observation.of_arrays(frames, scans, np.empty((2, 0), np.float32))
    noise = np.zeros((2, 2), np.float32)

    mean = decide(policy, seen, noise, np.ones(2, np.bool_)).actions

    np.testing.assert_allclose(mean, forms.torch_outputs(model, frames, scans), atol=1e-5)
    with pytest.raises(NotAvailable, match="it only has the mean of the actions"):
        decide(policy, seen, noise, np.zeros(2, np.bool_))


class Stranger:
    """Writes ONNX files that choose by the mean grey of pictures: the brighter, the later."""

    def __init__(self, folder):
        self.path = folder / "policy.onnx"
        (folder / "model_metadata.json").write_bytes(metadata_json())

    def write(
        self,
        shape=("n", 1, 120, 160),
        *,
        name="picture",
        kind=FLOAT,
        output="logits",
        full=255.0,
        count=5,
        extra=None,
        **props,
    ):
        steps = np.arange(count, dtype=np.float32)
        weights = {
            "steps": steps.reshape(1, count),
            "half": (-0.5 * steps**2 / (count - 1)).reshape(1, count),
            "full": np.array(full / 10.0, np.float32),
            "ten": np.array(10.0, np.float32),
        }
        axes = list(range(1, len(shape)))
        nodes = [
            helper.make_node("Cast", [name], ["floats"], to=FLOAT),
            helper.make_node("ReduceMean", ["floats"], ["mean"], axes=axes, keepdims=0),
            helper.make_node("Reshape", ["mean", "column"], ["means"]),
            helper.make_node("Div", ["means", "full"], ["share"]),
            helper.make_node("MatMul", ["share", "steps"], ["linear"]),
            helper.make_node("Mul", ["half", "ten"], ["bent"]),
            helper.make_node("Add", ["linear", "bent"], ["logits"]),
            helper.make_node("Softmax", ["logits"], ["probabilities"], axis=1),
            helper.make_node("ArgMax", ["logits"], ["index"], axis=1, keepdims=0),
        ]
        weights["column"] = np.array([-1, 1], np.int64)
        outputs = {
            "logits": (FLOAT, ["n", count]),
            "probabilities": (FLOAT, ["n", count]),
            "index": (INT64, ["n"]),
        }
        inputs = [helper.make_tensor_value_info(name, kind, shape)]
        inputs += [helper.make_tensor_value_info(*each) for each in extra or ()]
        graph = helper.make_graph(
            nodes,
            "g",
            inputs,
            [helper.make_tensor_value_info(output, *outputs[output])],
            [onnx.numpy_helper.from_array(array, key) for key, array in weights.items()],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
        helper.set_model_props(model, props)
        self.path.write_bytes(model.SerializeToString())
        return read_policy_file(self.path)


@pytest.fixture
def stranger(tmp_path):
    return Stranger(tmp_path)


def chosen(file, runtime="onnx", channels=1):
    """The actions at pictures that are black, three greys and white."""
    greys = np.array([0, 64, 128, 191, 255], np.uint8)
    frames = np.broadcast_to(greys[:, None, None, None], (5, channels, 120, 160))
    policy = policy_of_file(file, runtime)
    seen = Observation.of_arrays(frames.copy(), *np.empty((2, 5, 0), np.float32))
    noise = np.zeros((5, 2), np.float32)
    return decide(policy, seen, noise, np.ones(5, np.bool_)).actions.tolist()


@pytest.mark.parametrize("runtime", ["onnx", "openvino"])
@pytest.mark.parametrize(
    "how",
    [
        {"shape": ("n", 1, 120, 160)},
        {"shape": ("n", 120, 160, 1)},
        {"shape": ("n", 120, 160)},
        {"shape": (1, 1, 120, 160)},
        {"shape": (4, 1, 120, 160)},
        {"kind": UINT8},
        {"name": "main/FRONT_FACING_CAMERA:0"},
        {"name": "observation"},
        {"output": "probabilities"},
        {"output": "index"},
        {"full": 1.0, "Image.NominalPixelRange": "Normalized_0_1"},
    ],
    ids=str,
)
def test_a_strangers_file_is_driven_whatever_its_layout(stranger, how, runtime):
    if runtime == "openvino":
        pytest.importorskip("openvino")

    assert chosen(stranger.write(**how), runtime) == [0, 1, 2, 3, 4]


def test_more_channels_are_a_stack_of_frames(stranger):
    file = stranger.write(("n", 3, 120, 160))

    assert policy_of_file(file).spec.stack == 3
    assert chosen(file, channels=3) == [0, 1, 2, 3, 4]


def lidar(*shape):
    return [("LIDAR", FLOAT, shape)]


@pytest.mark.parametrize(
    ("how", "metadata", "why"),
    [
        ({"shape": ("n", 1, 84, 84)}, {}, r"\(any x 1 x 84 x 84\).* has pictures of 120 x 160"),
        ({"shape": ("n", "c", "h", "w")}, {}, "has pictures of 120 x 160 pixels and 1 channel"),
        ({"name": "STEREO_CAMERAS"}, {}, "has the input STEREO_CAMERAS.*FRONT_FACING_CAMERA"),
        ({"shape": ("n", 3, 120, 160)}, {"sensor": ["STEREO_CAMERAS"]}, "3 channels.*2 channels"),
        ({"count": 6}, {}, r"gives logits \(3 x 6\) for 3 pictures.* has 5 discrete actions"),
        ({}, {"sensor": ["FRONT_FACING_CAMERA", "LIDAR"]}, "the sensors FRONT_FACING_CAMERA and L"),
        ({"extra": lidar("n", 64)}, {}, "has the inputs picture .* LIDAR .* has the sensors FRONT"),
        (
            {"extra": lidar("n", 8)},
            {"sensor": ["FRONT_FACING_CAMERA", "LIDAR"]},
            "values as LIDAR, but .* has 64 of them",
        ),
        (
            {"output": "index", "count": 9},
            {"action_space": [{"steering_angle": 0, "speed": 1}]},
            "chooses action|gives index",
        ),
        ({"Image.NominalPixelRange": "Normalized_1_1"}, {}, "pixels in the range"),
    ],
    ids=str,
)
def test_a_file_that_does_not_fit_its_metadata_is_refused(stranger, how, metadata, why):
    (stranger.path.parent / "model_metadata.json").write_bytes(metadata_json(**metadata))

    with pytest.raises(SettingsError, match=why) as caught:
        check_file(stranger.write(**how), "onnx")

    assert str(stranger.path) in str(caught.value)


@pytest.mark.parametrize(
    ("runtime", "missing", "extra"),
    [
        ("onnx", "onnxruntime", '"drcli[onnx]"'),
        ("onnx", "onnx", '"drcli[onnx]"'),
        ("openvino", "openvino", '"drcli[openvino]"'),
        ("tflite", "ai_edge_litert tensorflow", '"drcli[tflite]"'),
    ],
)
def test_what_is_not_installed_is_named(monkeypatch, runtime, missing, extra):
    monkeypatch.setattr(
        "drcli.base.installation.is_installed", lambda name: name not in missing.split()
    )
    metadata = small_metadata()

    with pytest.raises(NotAvailable, match="which is not installed") as caught:
        policy_of_model(small_network(metadata), metadata, runtime, "the model")

    assert extra in caught.value.remedy


def test_an_engine_that_does_not_run_a_form_names_those_that_do(stranger):
    with pytest.raises(SettingsError, match="--runtime tflite does not run") as caught:
        check_file(stranger.write(), "tflite")

    assert caught.value.remedy == "Use --runtime onnx or openvino or pb."


@pytest.mark.parametrize("runtime", ["onnx", "openvino"])
def test_damage_is_explained_in_a_sentence(stranger, runtime):
    pytest.importorskip("openvino")
    whole = stranger.write()
    model = onnx.load_model_from_string(whole.data)
    model.graph.node[4].input[1] = "column"  # a product of numbers and integers
    broken = PolicyFile(**{**vars(whole), "data": model.SerializeToString()})

    with pytest.raises(SettingsError) as caught:
        check_file(broken, runtime)

    assert str(caught.value).startswith(str(stranger.path))
    assert "\n" not in str(caught.value)


def test_values_that_are_not_numbers_are_refused(stranger):
    with pytest.raises(SettingsError, match="gives values that are not numbers"):
        check_file(stranger.write(full=0.0), "onnx")


def test_openvinos_own_files_run(tmp_path):
    pytest.importorskip("openvino")
    from drcli.convert.engines import openvino_of
    from drcli.convert.frozen_graph import encode_policy

    metadata = small_metadata()
    model = small_network(metadata)
    graph = encode_policy(forms.weights_of(model), model.spec, metadata.sensor)
    sizes = []
    for fp16, most in ((False, 1e-4), (True, 1e-2)):
        xml, weights = openvino_of(graph, "model.pb", fp16=fp16)
        file = PolicyFile("openvino", xml, weights, "a.xml", metadata, "m.json", "")
        policy = policy_of_file(file)
        found = forms.compare(model, policy, *forms.sample_inputs(model.spec, 6))
        assert found.greatest_difference < most
        sizes.append(len(weights))
    assert sizes[1] < 0.6 * sizes[0]


def test_a_signal_may_come_after_engines_are_gone():
    """Each of OpenVINO's cores changes the stack on which signals are handled."""
    pytest.importorskip("openvino")
    code = (
        "import gc, os, signal\n"
        "from drcli.base.installation import openvino_core\n"
        "signal.signal(signal.SIGTERM, lambda *_: print('heard'))\n"
        "cores = [openvino_core() for _ in range(3)]\n"
        "for core in cores:\n"
        "    core.get_property('CPU', 'FULL_DEVICE_NAME')\n"
        "del core\n"
        "while cores:\n"
        "    del cores[0]\n"
        "    gc.collect()\n"
        "os.kill(os.getpid(), signal.SIGTERM)\n"
    )

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)

    assert (done.returncode, done.stdout) == (0, "heard\n"), done.stderr


def test_tensorflow_lite_with_the_settings_of_the_car():
    pytest.importorskip("tensorflow", reason="TensorFlow converts to TensorFlow Lite")
    metadata = small_metadata()
    model = small_network(metadata)

    policy = policy_of_model(model, metadata, "tflite", "the model")
    found = forms.compare(model, policy, *forms.sample_inputs(model.spec, 6))

    assert found.greatest_difference < 1e-2
