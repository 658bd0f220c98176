"""The car's archive: what we write passes the car's rules, and each rule is found when broken."""

import gzip
import io
import json
import tarfile
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from drcli.convert.build_network import weights_of
from drcli.convert.car_archive import car_archive, check_car_archive, lint_car_archive
from drcli.convert.car_rules import car_file_name
from drcli.convert.frozen_graph import policy_nodes
from drcli.convert.tensorflow.graph import Node, Shape, encode_graph
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import PolicySpec
from drcli.learn.sac_networks import SACAgent
from drcli.model.files.model_metadata import ModelMetadata

REFERENCE = Path(__file__).resolve().parents[4] / "shared" / "reference-models"
AGENT = "main_level/agent/main/online"
POLICY = f"{AGENT}/network_1/ppo_head_0/policy"
RANGES = {"steering_angle": {"low": -30, "high": 30}, "speed": {"low": 0.5, "high": 2}}
METADATA: dict[str, Any] = {
    "action_space": [
        {"steering_angle": -30, "speed": 1},
        {"steering_angle": 0, "speed": 2},
        {"steering_angle": 30, "speed": 1},
    ],
    "action_space_type": "discrete",
    "sensor": ["FRONT_FACING_CAMERA"],
    "neural_network": "COMPACT_CONVOLUTIONAL_NETWORK",
    "training_algorithm": "clipped_ppo",
    "version": "5",
}
SAC = {
    **METADATA,
    "training_algorithm": "sac",
    "action_space_type": "continuous",
    "action_space": RANGES,
}


def test_the_archive_has_exactly_two_files_and_is_always_the_same():
    data = car_archive(graph(), metadata())

    with tarfile.open(fileobj=io.BytesIO(data)) as tar:
        assert sorted(tar.getnames()) == ["agent/model.pb", "model_metadata.json"]
        assert all(member.isfile() and member.mode == 0o644 for member in tar)
    assert data == car_archive(graph(), metadata())


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"sensor": ["observation"], "version": "1"},
        {"sensor": ["LEFT_CAMERA"], "action_space": RANGES, "action_space_type": "continuous"},
        SAC,
        {"training_algorithm": "Clipped_PPO", "action_space_type": "DISCRETE"},
    ],
)
def test_what_we_write_passes_all_rules(changes):
    written = metadata(**changes)

    problems = lint_car_archive(car_archive(graph(**changes), written), "model-1.tar.gz")

    assert [problem for problem in problems if problem.severity != "note"] == []


def test_the_metadata_has_the_sensor_of_the_graph_and_no_keys_that_the_car_refuses():
    old = metadata(version="1", sensor=["STEREO_CAMERAS"], lidar_config={"num_sectors": 8})

    with tarfile.open(fileobj=io.BytesIO(car_archive(graph(), old))) as tar:
        file = tar.extractfile("model_metadata.json")
        assert file is not None
        values = json.load(file)

    assert values["sensor"] == ["observation"]
    assert "lidar_config" not in values
    assert values["action_space"] == METADATA["action_space"]


def test_a_graph_of_the_reference_passes_all_rules():
    if not REFERENCE.is_dir():
        pytest.skip("the reference's model is not here")
    files = {
        "agent/model.pb": (REFERENCE / "model_30.pb").read_bytes(),
        "model_metadata.json": (REFERENCE / "model_metadata.json").read_bytes(),
    }

    found = check_car_archive(packed(files), "downloads/model-30.tar.gz")

    assert found.problems == ()
    assert [action.throttle for action in found.actions[1:3]] == [0.8, 1.0]
    assert found.actions[0].steering == -1.0


@pytest.mark.parametrize(
    ("extra", "rule", "text"),
    [
        ({"old/model.pb": b"g"}, "C-02", "contains 2 files that end in .pb"),
        ({"agent/._model.pb": b"g"}, "C-02", "contains 2 files that end in .pb"),
        ({"agent/checkpoint": b"x"}, "C-03", "agent/checkpoint"),
        ({".coach_checkpoint": b"x"}, "C-03", ".coach_checkpoint"),
        ({"model/.ready": b""}, "C-03", "model/.ready"),
        ({"weights.p": b"x"}, "C-03", "weights.p"),
        ({"weights.b": b"x"}, "C-03", "weights.b"),
        ({"dot.": b"x"}, "C-03", "dot."),
    ],
)
def test_files_that_the_car_takes_for_models_are_errors(extra, rule, text):
    (error,) = errors({**files(), **extra})

    assert error.rule == rule
    assert text in error.message


def test_files_with_other_ends_are_allowed():
    more = {"training_params.yaml": b"", "folder.d/hyperparameters.json": b"{}", "README.md": b""}

    assert errors({**files(), **more}) == []


def test_a_missing_graph_and_misplaced_metadata_are_errors():
    only = {"agent/model_metadata.json": json.dumps(METADATA).encode()}

    found = errors(only)

    assert [error.rule for error in found] == ["C-02", "C-04"]
    assert "contains 0 files that end in .pb" in found[0].message
    assert "agent/model_metadata.json" in found[1].message


@pytest.mark.parametrize(
    ("name", "better"),
    [
        ("model.v2.tar.gz", "model-v2.tar.gz"),
        ("my model.tar.gz", "my-model.tar.gz"),
        ("model.tgz", "model-tgz.tar.gz"),
        ("modèle.tar.gz", "mod-le.tar.gz"),
        ("aws-golden-model-for-reinvent.tar.gz", None),
    ],
)
def test_a_file_name_that_the_car_changes_is_an_error(name, better):
    (error,) = lint_car_archive(packed(files()), f"folder/{name}")

    assert error.rule == "C-05"
    assert better is None or better in error.remedy


@pytest.mark.parametrize("name", ["model-1", "team.model", "AWS Sample", "...", "赛车", "a b.c"])
def test_every_model_gets_a_file_name_that_the_car_takes(name):
    assert lint_car_archive(packed(files()), car_file_name(name)) == []


@pytest.mark.parametrize(
    ("changes", "rule", "text"),
    [
        ({"sensor": ["front_facing_camera"]}, "C-07", "front_facing_camera"),
        ({"sensor": [["FRONT_FACING_CAMERA"]]}, "C-07", "FRONT_FACING_CAMERA"),
        ({"sensor": "FRONT_FACING_CAMERA"}, "C-06", "is not a list of sensors"),
        ({"training_algorithm": "dqn"}, "C-06", "dqn"),
        ({"training_algorithm": ["sac"]}, "C-06", "sac"),
        ({"action_space_type": "continuous"}, "C-06", "has no ranges"),
        ({"action_space_type": "both"}, "C-06", "both"),
        ({"action_space": None}, "C-06", "is missing"),
        ({"action_space": []}, "C-06", "is not a list of actions"),
        ({"action_space": [{"speed": 1}]}, "C-06", "in action 0"),
        ({"action_space": [{"speed": True, "steering_angle": 1}]}, "C-06", "in action 0"),
        ({"action_space": [{"speed": 1e400, "steering_angle": 1}]}, "C-06", "in action 0"),
        ({"lidar_config": {"num_sectors": 8}}, "C-08", "lacks num_values, min_angle"),
        ({"lidar_config": []}, "C-08", "lacks num_values"),
    ],
)
def test_metadata_that_the_car_does_not_know_is_an_error(changes, rule, text):
    found = errors(files(metadata={**METADATA, **changes}))

    assert rule in [error.rule for error in found]
    assert any(text in error.message for error in found)
    assert all("model_metadata.json" in str(error) for error in found if error.rule == rule)


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"\xff\xfe", b"\xef\xbb\xbf{}", b"[" * 5000])
def test_metadata_that_is_no_json_object_is_an_error(data):
    found = errors({**files(), "model_metadata.json": data})

    assert found[0].rule == "C-06"
    assert "\n" not in str(found[0])


def test_a_complete_lidar_config_is_allowed():
    keys = (
        *("num_values", "min_angle", "max_angle", "min_distance", "max_distance"),
        *("clipping_distance", "num_sectors"),
    )

    assert errors(files(metadata={**METADATA, "lidar_config": dict.fromkeys(keys, 1)})) == []


def test_missing_keys_have_the_defaults_of_the_car():
    few = {"action_space": METADATA["action_space"]}

    assert errors(files(metadata=few, sensor=["observation"])) == []
    (error, other) = errors(files(metadata=few))
    assert "network_0/observation/observation" in error.message
    assert "FRONT_FACING_CAMERA" in other.message


def test_a_lidar_of_the_simulator_is_refused_by_the_car():
    found = errors(files(metadata={**METADATA, "sensor": ["DISCRETIZED_SECTOR_LIDAR"]}))

    assert found[0].rule == "V-33"
    assert "DISCRETIZED_SECTOR_LIDAR" in found[0].message


def test_a_graph_for_another_number_of_actions_is_an_error():
    actions = METADATA["action_space"][:2]

    (error,) = errors(files(metadata={**METADATA, "action_space": actions}))

    assert error.rule == "C-11"
    assert "its output has 3 values, but the metadata file needs 2" in error.message


def test_a_graph_of_the_other_algorithm_is_an_error():
    found = errors({**files(metadata=SAC), "agent/model.pb": graph()})

    assert {error.rule for error in found} == {"C-10", "C-11"}
    assert "main_level/agent/policy/online/network_0/FRONT_FACING_CAMERA" in found[0].message


def test_the_output_where_the_reference_puts_it_with_sac_is_a_warning():
    renamed = [
        replaced(
            node, name=node.name.replace("network_1/ppo_head_0", "network_0/sac_policy_head_0")
        )
        for node in nodes(**SAC)
    ]

    (found,) = lint({**files(metadata=SAC), "agent/model.pb": encode_graph(renamed)})

    assert (found.rule, found.severity) == ("C-11", "warning")
    assert "TensorFlow Lite" in found.message


def test_a_second_output_is_a_warning():
    more = [*nodes(), Node(f"{AGENT}/value", "Identity", (POLICY,))]
    more = [*more, Node(f"{AGENT}/other", "Tanh", (more[-2].inputs[0],))]

    rules = [p.rule for p in lint({**files(), "agent/model.pb": encode_graph(more)})]

    assert rules == ["C-11"]


def test_an_operation_that_engines_may_not_convert_is_a_warning():
    other = [replaced(node, op="Elu") if node.op == "Relu" else node for node in nodes()]

    (found,) = lint({**files(), "agent/model.pb": encode_graph(other)})

    assert (found.rule, found.severity) == ("C-12", "warning")
    assert "Elu" in found.message


@pytest.mark.parametrize(
    ("shape", "fits"),
    [((-1, 120, 160, 1), True), ((1, 120, 160, 1), True), ((-1, 120, 160, 3), False)],
)
def test_an_input_of_another_shape_is_an_error(shape, fits):
    other = [
        replaced(node, attrs={**node.attrs, "shape": Shape(shape)})
        if node.op == "Placeholder"
        else node
        for node in nodes()
    ]

    found = errors({**files(), "agent/model.pb": encode_graph(other)})

    assert [error.rule for error in found] == ([] if fits else ["C-10"])


def test_layers_that_do_not_fit_each_other_are_an_error():
    kernel = next(node for node in nodes() if node.name.endswith("Dense_0/kernel"))
    assert kernel.value is not None
    other = [replaced(n, value=kernel.value[1:]) if n.name == kernel.name else n for n in nodes()]

    (error,) = errors({**files(), "agent/model.pb": encode_graph(other)})

    assert error.rule == "C-09"
    assert "MatMul" in error.message


def test_values_that_are_not_finite_are_an_error():
    def spoilt(node: Node) -> Node:
        if node.value is None or not node.name.endswith("policy_fc/bias"):
            return node
        return replaced(node, value=np.full_like(node.value, np.nan))

    (error,) = errors({**files(), "agent/model.pb": encode_graph([*map(spoilt, nodes())])})

    assert error.rule == "C-09"
    assert "policy_fc/bias" in error.message


@pytest.mark.parametrize("data", [b"", b"not a graph", b"\x0a\xff\xff\xff\xff\x0f", b"PK\x03\x04"])
def test_a_graph_that_is_none_is_an_error(data):
    (error,) = errors({**files(), "agent/model.pb": data})

    assert error.rule == "C-09"


def test_a_graph_that_computes_something_huge_from_constants_is_not_run():
    large = Node("large", "Const", value=np.ones((100_000, 1), np.float32))
    wide = Node("wide", "Const", value=np.ones((1, 100_000), np.float32))
    huge = Node("huge", "Mul", ("large", "wide"))
    last = nodes()[-1]
    crafted = [*nodes()[:-1], large, wide, huge, replaced(last, inputs=(*last.inputs, "huge"))]

    (found,) = lint({**files(), "agent/model.pb": encode_graph(crafted)})

    assert (found.rule, found.severity) == ("C-12", "warning")
    assert "huge" in found.message


def test_a_plain_tar_is_an_error_because_the_web_page_only_takes_compressed_ones():
    (error,) = lint_car_archive(gzip.decompress(packed(files())), "model.tar.gz")

    assert error.rule == "C-01"


def test_an_archive_that_cannot_be_read_is_one_error():
    (error,) = lint_car_archive(b"no archive", "model.tar.gz")

    assert (error.rule, error.severity) == ("C-01", "error")


def metadata(**changes: Any) -> ModelMetadata:
    return ModelMetadata.from_bytes(json.dumps({**METADATA, **changes}).encode())


def nodes(**changes: Any) -> Sequence[Node]:
    """The graph of a fresh policy."""
    return _nodes(json.dumps(changes))


@cache
def _nodes(changes: str) -> Sequence[Node]:
    made = metadata(**json.loads(changes))
    space = made.action_space
    spec = PolicySpec(space.num_actions, space.continuous, made.neural_network, made.eyes)
    torch.manual_seed(1)
    model = SACAgent(spec) if made.training_algorithm == "sac" else ActorCritic(spec)
    return tuple(policy_nodes(weights_of(model), spec, made.sensor))


def graph(**changes: Any) -> bytes:
    return encode_graph(nodes(**changes))


def files(metadata: Mapping[str, Any] = METADATA, **changes: Any) -> dict[str, bytes]:
    """The files of an archive; the graph is that of the usual metadata with these changes."""
    changes = {**(SAC if metadata is SAC else {}), **changes}
    return {
        "agent/model.pb": graph(**changes),
        "model_metadata.json": json.dumps(metadata).encode(),
    }


def packed(files: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz", compresslevel=0) as tar:
        for name, data in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
    return stream.getvalue()


def lint(files: Mapping[str, bytes]) -> list[Any]:
    """Errors and warnings about an archive."""
    problems = lint_car_archive(packed(files), "model.tar.gz")
    assert all(problem.remedy and "\n" not in str(problem) for problem in problems)
    return [problem for problem in problems if problem.severity != "note"]


def errors(files: Mapping[str, bytes]) -> list[Any]:
    return [problem for problem in lint(files) if problem.severity == "error"]


def replaced(node: Node, **changes: Any) -> Node:
    fields = {name: getattr(node, name) for name in ("name", "op", "inputs", "attrs", "value")}
    return Node(**{**fields, **changes})
