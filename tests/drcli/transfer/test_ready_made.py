"""The ready-made models are what their cards say, and usable from the first command on."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest
from drive_laps import drive_laps

from drcli.base.errors import SettingsError
from drcli.bucket.connect import FolderBucket
from drcli.bucket.server import server
from drcli.config import presets
from drcli.config.loading import load_settings
from drcli.config.presets import READY_MADE, model_file, ready_made
from drcli.config.track_names import expand_worlds
from drcli.convert.build_network import build_policy, load_weights
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.model.model_store import ModelStore
from drcli.transfer.pretrained import read_weights
from drcli.transfer.ready_made import (
    CARD_FILE,
    TRAINING_FILE,
    WEIGHTS_FILE,
    read_ready_made,
    read_recipe,
)

SLOWER = 0.1
"""Another processor rounds differently, so a lap may take so much longer or shorter."""

every_model = pytest.mark.parametrize("name", ready_made())


@every_model
def test_files_and_card_agree(name):
    model = read_ready_made(name)

    for file, sha256 in model.card.sha256.items():
        data = model_file(f"models/{name}/{file}").read_bytes()
        assert hashlib.sha256(data).hexdigest() == sha256
    assert {*model.files, TRAINING_FILE, WEIGHTS_FILE} == set(model.card.sha256)
    assert model.card.laps
    assert {laps.world for laps in model.card.laps} == set(model.recipe.drives)


@every_model
def test_it_drives_the_lap_of_its_card(name):
    model = read_ready_made(name)
    told = model.card.laps[0]

    driven = drive_laps(model, told.world, reverse=told.reverse, disturbed=told.disturbed, laps=1)

    assert driven.status == ["Lap complete"] == told.status[:1]
    assert driven.lap_s[0] == pytest.approx(told.lap_s[0], rel=SLOWER)


@pytest.mark.parametrize("name", READY_MADE)
def test_every_recipe_can_be_read_and_begins_with_a_model_before_it(name):
    recipe = read_recipe(name)

    before = READY_MADE[: READY_MADE.index(name)]
    assert recipe.starts_from in ("", *before) or recipe.starts_from in READY_MADE
    assert recipe.starts_from != name
    files = {file: model_file(f"models/{name}/{file}") for file in ("hyperparameters.json",)}
    parameters = json.loads(files["hyperparameters.json"].read_text())
    Hyperparameters.from_bytes(json.dumps(parameters | recipe.hyperparameters).encode())


def test_a_damaged_model_is_refused_with_its_file(tmp_path, monkeypatch):
    name = ready_made()[0]
    shutil.copytree(model_file(f"models/{name}"), tmp_path / "models" / name)
    monkeypatch.setattr("drcli.transfer.ready_made.model_file", lambda file: tmp_path / file)
    weights = tmp_path / "models" / name / WEIGHTS_FILE
    weights.write_bytes(weights.read_bytes()[:-1] + b"!")

    with pytest.raises(SettingsError, match=r"model\.safetensors.*not the one"):
        read_ready_made(name)

    (tmp_path / "models" / name / CARD_FILE).write_text("{}")
    with pytest.raises(SettingsError, match=r"card\.json"):
        read_ready_made(name)


def test_a_new_folder_gets_the_model_into_its_bucket(working_folder, dr, capsys):
    name = ready_made()[0]
    expected = read_ready_made(name)

    code = dr("init", "racer", "--model", name, "--json")

    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    folder = working_folder / "racer"
    settings = load_settings(folder, environ={})
    server.stop(settings.storage)
    assert code == 0
    assert report["model"] == f"s3://bucket/{name}"
    bucket = FolderBucket(folder / "data" / "s3" / "bucket")
    place = settings.place("DR_LOCAL_S3_MODEL_PREFIX")
    for choice in ("last", "best"):
        source, found, _ = read_weights(ModelStore(bucket, name), choice, "X", place)
        assert source.name == expected.card.checkpoint == report["checkpoint"]
    design = Design.of_model(ModelStore(bucket, name))
    model = build_policy(design.metadata, design.parameters)
    load_weights(model, found.tensors, source.name)
    for file, data in expected.files.items():
        assert (folder / "custom_files" / file).read_bytes() == data
    assert ModelMetadata.from_bytes(expected.files["model_metadata.json"]) == design.metadata
    assert settings.world_name == expected.recipe.settings["DR_WORLD_NAME"]

    code = dr("init", "racer", "--model", name, "--force")
    server.stop(settings.storage)

    assert code == 3
    assert "already contains a model" in capsys.readouterr().err


def test_a_model_of_many_tracks_goes_on_with_all_of_them():
    settings = read_ready_made("unseen").settings

    assert expand_worlds(settings["DR_TRAIN_WORLDS"], Path("tracks"))[:2] == ("zoo-0", "zoo-1")
    assert [name for name in settings if name.startswith("DR_TRAIN_")] == ["DR_TRAIN_WORLDS"]


def test_an_unknown_model_and_one_that_is_not_shipped_are_refused(
    working_folder, dr, capsys, monkeypatch, tmp_path
):
    before = set(working_folder.iterdir())

    assert dr("init", "racer", "--model", "saef") == 2
    assert "Did you mean safe?" in capsys.readouterr().err.replace("\n", " ")
    monkeypatch.setattr(presets, "model_file", lambda file: tmp_path / "none" / file)
    assert dr("init", "racer", "--model", "safe") == 2

    assert set(working_folder.iterdir()) == before
