"""The examples run as they stand."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from drcli.convert.build_network import weights_of
from drcli.convert.frozen_graph import policy_nodes
from drcli.convert.onnx_graph import encode_onnx
from small_policies import metadata_json, small_metadata, small_network

pytestmark = pytest.mark.nightly

EXAMPLES = Path(__file__).resolve().parents[3] / "scripts" / "examples"


def run(name: str, *options: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, str(EXAMPLES / name), *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_the_single_file_example_trains_for_a_moment():
    done = run("train_cleanrl.py", "--total-steps", "64", "--num-envs", "4", "--num-steps", "8")

    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 2
    assert "progress" in done.stdout


def test_the_other_example_says_in_a_sentence_what_it_needs():
    if importlib.util.find_spec("stable_baselines3") is not None:
        pytest.skip("Stable-Baselines3 is installed here")

    done = run("train_sb3.py")

    assert done.returncode == 1
    assert done.stderr.strip() == (
        "This example needs Stable-Baselines3: pip install stable-baselines3"
    )


def test_an_onnx_file_drives_without_a_trainer(tmp_path):
    pytest.importorskip("onnxruntime")
    metadata = small_metadata()
    model = small_network(metadata)
    nodes = policy_nodes(weights_of(model), model.spec, metadata.sensor)
    (tmp_path / "policy.onnx").write_bytes(encode_onnx(nodes, "policy.onnx"))
    (tmp_path / "policy.model_metadata.json").write_bytes(metadata_json())

    done = run("drive_onnx.py", str(tmp_path / "policy.onnx"))

    assert done.returncode == 0, done.stderr
    assert " progress " in done.stdout
