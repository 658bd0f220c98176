"""`dr init --preset` and `dr config preset`: folders for a purpose. Seeds 002-01, 002-03."""

import json

import pytest

from drcli.checks.config_check import check_alone
from drcli.config.loading import load_settings
from drcli.config.presets import model_file, preset_names, preset_of, presets_folder
from drcli.config.settings import catalogue
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata


@pytest.mark.parametrize("name", preset_names())
def test_a_folder_of_a_preset_is_complete_and_has_its_settings(dr, empty, name):
    code = dr("init", "--preset", name, "--force")

    settings = load_settings(empty, environ={})
    metadata = ModelMetadata.from_bytes((empty / "custom_files/model_metadata.json").read_bytes())
    Hyperparameters.from_bytes((empty / "custom_files/hyperparameters.json").read_bytes())
    assert code == 0
    assert check_alone(empty).errors == ()
    assert settings.warnings == ()
    assert metadata.problems == ()
    for key, text in preset_of(name).settings.items():
        setting = catalogue()[key]
        assert getattr(settings, setting.field) == setting.read(text), key
        assert settings.place(key).file == "run.env", key
    for file, data in preset_of(name).files.items():
        written = (empty / "custom_files" / file).read_bytes()
        assert written.replace(b'  "training_method": "teacher",\n', b"") == data


@pytest.mark.parametrize("name", ["virtual", "unseen", "physical", "student-league"])
def test_every_setting_of_a_preset_has_a_reason(name):
    preset = preset_of(name)

    assert preset.summary
    assert all(preset.reasons[setting] for setting in preset.settings)


def test_the_student_league_has_its_limits():
    """002-03."""
    preset = preset_of("student-league")
    metadata = ModelMetadata.from_bytes(preset.files["model_metadata.json"])

    assert (metadata.action_space.low, metadata.action_space.high) == ((-30, 0.5), (30, 1.0))
    assert preset.settings["DR_TRAIN_MAX_MINUTES"] == "600"


_NO_EXTRAS = "DR_SIM_CAR", "DR_SIM_EXTRAS_IN", "DR_SIM_GRAY_OVERLAY", "DR_SIM_GROW"


def test_the_physical_preset_disturbs_and_the_virtual_one_does_not(dr, empty):
    """002-01."""
    extras = [name for name in catalogue() if name.startswith("DR_SIM_")]
    extras = [name for name in extras if name not in _NO_EXTRAS]
    fastest = {}

    for name in ("physical", "virtual"):
        preset = preset_of(name)
        space = ModelMetadata.from_bytes(preset.files["model_metadata.json"]).action_space
        fastest[name] = space.high[1] if space.high else max(speed for _, speed in space.values)

    assert set(extras) == set(preset_of("physical").settings) & set(extras)
    assert not set(extras) & set(preset_of("virtual").settings)
    assert fastest["physical"] < 0.5 * fastest["virtual"]


def test_the_fast_files_are_those_of_the_virtual_preset():
    files = preset_of("virtual").files

    assert len(files) == 3
    for name, data in files.items():
        assert data == model_file(f"rewards/speed/{name}").read_bytes()


def test_options_win_over_the_preset_and_no_setting_stands_twice(dr, empty):
    dr("init", "--preset", "physical", "--world", "bean", "--race-type", "HEAD_TO_BOT", "--force")

    settings = load_settings(empty, environ={})
    lines = (empty / "run.env").read_text().splitlines()
    names = [line.partition("=")[0] for line in lines if line.startswith("DR_")]
    reward = (empty / "custom_files/reward_function.py").read_bytes()
    assert (settings.world_name, settings.race_type) == ("bean", "HEAD_TO_BOT")
    assert settings.sim_battery == 0.15
    assert len(names) == len(set(names))
    assert reward == model_file("rewards/head_to_bot/reward_function.py").read_bytes()


def test_an_experiment_takes_the_preset_and_keeps_the_racers_reward_function(dr, empty):
    dr("init", "--force")
    mine = b"def reward_function(params):\n    return 1.5\n"
    (empty / "custom_files/reward_function.py").write_bytes(mine)

    code = dr("init", "--experiment", "real", "--preset", "physical", "--force")

    there = empty / "experiments/real"
    assert code == 0
    assert "DR_SIM_GLARE=0.6" in (there / "run.env").read_text()
    assert (there / "custom_files/reward_function.py").read_bytes() == mine
    metadata = (there / "custom_files/model_metadata.json").read_bytes()
    assert metadata == preset_of("physical").files["model_metadata.json"]
    assert "DR_SIM_GLARE" not in (empty / "run.env").read_text()


def test_an_unknown_preset_is_refused_and_nothing_is_written(dr, empty, capsys):
    code = dr("init", "--preset", "fisical", "--force")

    said = capsys.readouterr().err
    assert code == 3
    assert "no preset called fisical" in said
    assert "Did you mean physical?" in said
    assert not (empty / "run.env").exists()


def test_presets_are_explained_with_and_without_a_folder(dr, empty, capsys):
    dr("config", "preset", "--json")
    without = json.loads(capsys.readouterr().out)["presets"]
    dr("init", "--force")
    dr("config", "set", "DR_SIM_BATTERY=0.3")
    capsys.readouterr()
    dr("config", "preset", "physical")
    text = capsys.readouterr().out
    dr("config", "preset", "physical", "--json")
    (preset,) = json.loads(capsys.readouterr().out)["presets"]

    assert [each["name"] for each in without] == preset_names()
    assert all(value["present"] is None for value in without[0]["settings"])
    battery = next(value for value in preset["settings"] if value["name"] == "DR_SIM_BATTERY")
    assert (battery["value"], battery["present"], battery["default"]) == ("0.15", "0.3", "0.0")
    assert "DR_SIM_BATTERY=0.15  # here 0.3, run.env line" in text
    assert "nearly empty" in text
    assert f"Files: {', '.join(preset['files'])}." in text


def test_a_folder_of_files_alone_is_a_preset(tmp_path, monkeypatch):
    """A preset need not have settings."""
    monkeypatch.setattr("drcli.config.presets.presets_folder", lambda: tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/hyperparameters.json").write_text("{}")
    (tmp_path / "empty").mkdir()

    assert preset_names() == ["mine"]
    assert preset_of("MINE").files == {"hyperparameters.json": b"{}"}
    assert preset_of("mine").settings == {}
    assert presets_folder().is_dir()
