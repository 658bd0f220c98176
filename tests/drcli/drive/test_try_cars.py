"""Every car is driven from starts all over the lap."""

from pathlib import Path

import pytest
import torch

from drcli.convert.build_network import load_arrays
from drcli.convert.read_graph import read_graph
from drcli.drive.try_cars import drive_car
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import PolicySpec
from drcli.model.files.model_metadata import ModelMetadata
from drcli.records.evaluation_task import CarTrial, DrivenCars
from drsim.car.car_parameters import CAR_SETS, DEFAULT_CAR
from drsim.sensing.scene import build_scene
from drsim.track.worlds import load_track

METADATA = b'{"action_space": [{"steering_angle": 30, "speed": 4.0}], "sensor": ["LEFT_CAMERA"]}'
MODELS = Path("../shared/reference-models")
TRACKS = Path("../shared/tracks")


def test_a_car_that_always_turns_gets_nowhere_from_any_start(tmp_path):
    track = load_track("reinvent_base")
    torch.manual_seed(0)
    policy = ActorCritic(PolicySpec(1, network="COMPACT_CONVOLUTIONAL_NETWORK")).eval()

    trial = drive_car(
        DEFAULT_CAR, track, build_scene(track), policy, ModelMetadata.from_bytes(METADATA), 3, 1
    )

    assert (trial.car, trial.laps, trial.starts, trial.lap_times_s) == (DEFAULT_CAR, 0, 3, [])
    assert 0.0 < trial.mean_progress < 50.0
    DrivenCars([trial]).write(tmp_path)
    assert DrivenCars.read(tmp_path) == DrivenCars([trial])


@pytest.mark.skipif(
    not (MODELS.is_dir() and TRACKS.is_dir()), reason="the reference's model is not here"
)
def test_a_model_of_the_reference_laps_with_the_car_that_suits_it():
    track = load_track("reInvent2019_wide", TRACKS)
    read = read_graph((MODELS / "model_30.pb").read_bytes(), "model_30.pb")
    policy = ActorCritic(read.spec).eval()
    load_arrays(policy, read.weights)
    metadata = ModelMetadata.from_bytes((MODELS / "model_metadata.json").read_bytes())

    trial = drive_car("low-grip", track, build_scene(track), policy, metadata, 2, 2)

    assert isinstance(trial, CarTrial)
    assert trial.laps == 2
    assert 7.0 <= min(trial.lap_times_s) <= max(trial.lap_times_s) <= 8.5
    assert "low-grip" in CAR_SETS
