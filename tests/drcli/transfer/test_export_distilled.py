"""`--distill` exports a network that every league takes, or nothing."""

import json

import pytest

from drcli.base.errors import SettingsError
from drcli.convert.imported_policy import read_reference_checkpoint
from drcli.model import keys
from drcli.records.training_record import TrainingStart
from drcli.train import distillation
from trained_model import put_trained_model

from .test_export_checkpoint import MODEL, files_of

COMPACT = {"neural_network": "COMPACT_CONVOLUTIONAL_NETWORK"}


@pytest.fixture
def short(monkeypatch):
    """One iteration; laps do not matter."""
    monkeypatch.setattr(distillation, "LAPS", 2)
    monkeypatch.setattr(distillation, "MIXED_ITERATIONS", 1)
    monkeypatch.setattr(distillation, "EPISODES", {"distillation": 2})
    monkeypatch.setattr(distillation, "LEAST_CLEAN", 0.0)
    monkeypatch.setattr(distillation.PhaseJudge, "most_steps", lambda *_: 1)


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("form", ["droa", "tf-checkpoint"])
def test_the_package_has_the_shallow_network_and_the_actions_of_the_model(
    dr, exporter, capsys, form
):
    put_trained_model(exporter.here, MODEL, numbers=(5,), **COMPACT)

    code = dr("export", form, "--distill", "--out", "out", "--json")

    printed = capsys.readouterr()
    assert code == 0, printed.err
    folder = exporter.folder / "out"
    metadata = json.loads((folder / "model/model_metadata.json").read_text())
    own = json.loads(exporter.here.get(keys.model_metadata(MODEL)))
    assert metadata == {**own, "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"}
    parts = [
        (folder / f"model/5_Step-500.ckpt{end}").read_bytes()
        for end in (".index", ".data-00000-of-00001")
    ]
    assert (
        read_reference_checkpoint(*parts, "5_Step-500.ckpt").network == metadata["neural_network"]
    )
    index = json.loads((folder / "model/deepracer_checkpoints.json").read_text())
    assert index["best_checkpoint"]["avg_eval_metric"] < 0, "nobody has evaluated this network"
    report = json.loads(printed.out.splitlines()[-1])
    assert "learned from the actions of this model" in report["notes"][0]
    assert "5_Step-500.ckpt drives 0 of 2 laps" in printed.err


def test_it_learns_on_the_tracks_of_all_workers_that_trained_the_model(dr, exporter, monkeypatch):
    put_trained_model(exporter.here, MODEL, numbers=(5,), **COMPACT)
    start = TrainingStart(
        1,
        settings={"DR_WORLD_NAME": "bean", "DR_TRAIN_REVERSE_DIRECTION": True},
        workers=[{"DR_WORLD_NAME": "willow"}, {"DR_TRAIN_REVERSE_DIRECTION": False}],
    )
    exporter.here.put(keys.training_start(MODEL), start.encode())
    asked = []

    def distil(races, *_, **__):
        asked.extend((race.world_name, race.train_reverse_direction) for race in races)
        raise SettingsError("That is all.", remedy="None.")

    monkeypatch.setattr(distillation, "distil", distil)

    assert dr("export", "droa", "--distill") == 3
    assert asked == [("bean", True), ("willow", True), ("bean", False)]


def test_nothing_is_written_if_it_does_not_lap(dr, exporter, monkeypatch, capsys):
    monkeypatch.setattr(distillation, "LAPS", 2)
    put_trained_model(exporter.here, MODEL, numbers=(5,), **COMPACT)
    before = files_of(exporter.folder)

    code = dr("export", "droa", "--distill")

    assert code == 3
    assert "completes 0 of 2 laps" in capsys.readouterr().err
    assert files_of(exporter.folder) == before


@pytest.mark.usefixtures("short")
def test_ctrl_c_leaves_nothing(dr, exporter, monkeypatch):
    put_trained_model(exporter.here, MODEL, numbers=(5,), **COMPACT)
    before = files_of(exporter.folder)

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(distillation.Distillation, "update", interrupted)

    assert dr("export", "droa", "--distill") == 130
    assert files_of(exporter.folder) == before


def test_a_place_that_cannot_be_used_is_refused_before_anything_is_learned(dr, exporter, capsys):
    put_trained_model(exporter.here, MODEL, numbers=(5,), world="my_cellar", **COMPACT)

    assert dr("export", "droa", "--distill") == 3

    said = capsys.readouterr().err
    assert "does not say in which direction" in said
    assert "drives" not in said


def test_a_network_of_the_reference_is_exported_as_it_is(dr, exporter, capsys):
    put_trained_model(exporter.here, MODEL, numbers=(5,))

    assert dr("export", "tf-checkpoint", "--distill", "--out", "out") == 0

    assert "--distill is not needed" in capsys.readouterr().err
    metadata = json.loads((exporter.folder / "out/model/model_metadata.json").read_text())
    assert metadata["neural_network"] == "DEEP_CONVOLUTIONAL_NETWORK_DEEP"


def test_a_seed_alone_is_a_wrong_command_line(dr, exporter):
    put_trained_model(exporter.here, MODEL, numbers=(5,))

    assert dr("export", "droa", "--seed", "3") == 2
