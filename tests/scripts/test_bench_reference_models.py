"""`scripts/bench_reference_models.py`: the printed object, and what it refuses."""

import importlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drcli.convert.build_network import policy_spec, weights_of
from drcli.convert.frozen_graph import encode_policy
from drcli.learn.actor_critic import ActorCritic
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drsim.car.car_parameters import CAR_SETS

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"

ACTIONS = [{"steering_angle": angle, "speed": 1.5} for angle in (-20, 0, 20)]
METADATA: dict[str, Any] = {
    "action_space": ACTIONS,
    "sensor": ["FRONT_FACING_CAMERA"],
    "neural_network": "COMPACT_CONVOLUTIONAL_NETWORK",
    "version": "5",
}


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A folder with an untrained policy that always drives straight on, and its metadata."""
    folder = tmp_path_factory.mktemp("policy")
    text = json.dumps(METADATA)
    (folder / "model_metadata.json").write_text(text)
    metadata = ModelMetadata.from_bytes(text.encode())
    spec = policy_spec(metadata, Hyperparameters.from_bytes(b"{}"))
    weights = weights_of(ActorCritic(spec))
    head = weights["policy_head.bias"]
    weights["policy_head.weight"] = np.zeros_like(weights["policy_head.weight"])
    weights["policy_head.bias"] = np.array([0, 1, 0], head.dtype)
    (folder / "model.pb").write_bytes(encode_policy(weights, spec, metadata.sensor))
    return folder


@pytest.fixture
def bench(files, monkeypatch, capsys) -> Callable[..., tuple[int, str, str]]:
    """Runs the benchmark: exit code, stdout, stderr."""

    def run(*more: str | Path, folder: Path = files) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", list(map(str, ["bench", *arguments(folder), *more])))
        code = importlib.import_module("reference_models").main()
        return code, *capsys.readouterr()

    return run


def arguments(folder: Path) -> list[str | Path]:
    metadata = folder / "model_metadata.json"
    return ["--model", folder / "model.pb", "--metadata", metadata, "--world", "reinvent_base"]


def test_each_car_has_a_row_and_an_entry_in_the_last_line(bench):
    code, out, _ = bench("--starts", "3", "--car", "all")

    *table, last = out.splitlines()
    cars = json.loads(last)["cars"]
    assert [car["car"] for car in cars] == list(CAR_SETS)
    assert [line.split()[0] for line in table] == list(CAR_SETS)
    for car in cars:
        assert list(car) == ["car", "laps", "starts", "mean_progress", "lap_times_s"]
        # Straight on ends in the first bend.
        assert (car["laps"], car["starts"], car["lap_times_s"]) == (0, 3, [])
        assert 1.0 < car["mean_progress"] < 60.0
    assert code == 0


def test_json_is_all_that_the_script_prints_and_release_6_is_the_default(files):
    script = ROOT / "scripts" / "bench_reference_models.py"
    command = [sys.executable, script, *arguments(files), "--starts", "2", "--json"]

    (line,) = subprocess.run(
        command, check=True, capture_output=True, text=True
    ).stdout.splitlines()

    assert [car["car"] for car in json.loads(line)["cars"]] == ["release-6"]


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (["--car", "lowgrip"], "--car lowgrip is not a car. Did you mean low-grip?"),
        (["--starts", "0"], "--starts 0 is not a number from 1 to 1000"),
        (["--world", "nowhere"], "There is no track 'nowhere' here"),
        (["--model", "none.pb"], "none.pb cannot be read (No such file or directory)"),
        (["--model", "cut.pb"], "cut.pb is not a TensorFlow graph"),
        (["--metadata", "cut.pb"], "cut.pb line 2: "),
        (["--metadata", "two.json"], "an output of shape [3], but the metadata have 2 actions"),
        (["--metadata", "left.json"], "takes FRONT_FACING_CAMERA, but the metadata have LEFT_"),
    ],
)
def test_what_cannot_be_driven_is_refused_in_a_sentence(
    bench, files, tmp_path, monkeypatch, given, sentence
):
    monkeypatch.chdir(tmp_path)
    Path("cut.pb").write_bytes((files / "model.pb").read_bytes()[:5000])
    Path("two.json").write_text(json.dumps(METADATA | {"action_space": ACTIONS[:2]}))
    Path("left.json").write_text(json.dumps(METADATA | {"sensor": ["LEFT_CAMERA"]}))

    code, out, err = bench(*given)

    assert (code, out) == (3, "")
    assert sentence in err
    assert len(err.splitlines()) == 1


def test_a_policy_of_the_reference_laps_with_the_car_that_suits_it(bench):
    models, tracks = SHARED / "reference-models", SHARED / "tracks"
    if not models.is_dir() or not tracks.is_dir():
        pytest.skip("the reference models and tracks do not lie beside this checkout")
    _, out, _ = bench(
        *("--model", models / "model_30.pb", "--world", "reInvent2019_wide"),
        *("--tracks-dir", tracks, "--starts", "4", "--car", "low-grip", "--json"),
        folder=models,
    )

    (car,) = json.loads(out)["cars"]
    assert car["laps"] == 4
    assert all(7.1 <= seconds <= 8.1 for seconds in car["lap_times_s"])
