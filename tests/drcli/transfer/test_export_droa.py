"""What `dr-export droa` writes is what DeepRacer on AWS looks for."""

import json
import tarfile

import pytest
import yaml

from drcli.model import keys
from trained_model import put_trained_model

from .test_export_checkpoint import MODEL, files_of

pytestmark = pytest.mark.usefixtures("small_checkpoints")

FILES = [
    "ip/hyperparameters.json",
    "model/.coach_checkpoint",
    "model/5_Step-500.ckpt.data-00000-of-00001",
    "model/5_Step-500.ckpt.index",
    "model/5_Step-500.ckpt.meta",
    "model/checkpoint",
    "model/deepracer_checkpoints.json",
    "model/model_5.pb",
    "model/model_metadata.json",
    "model_metadata.json",
    "reward_function.py",
    "training_params.yaml",
]


def export(dr, *options):
    return dr("export", "droa", "--out", "out", *options)


def test_folder_and_archive_hold_what_is_looked_for(dr, exporter, capsys):
    put_trained_model(exporter.here, MODEL, numbers=(5,))

    code = export(dr)

    folder = exporter.folder / "out"
    found = files_of(folder)
    metrics = [name for name in found if name.startswith("metrics/training/training-")]
    assert code == 0
    assert len(metrics) == 1  # only the first one is read there
    assert sorted(set(found) - set(metrics)) == FILES
    with tarfile.open(exporter.folder / "out.tar.gz") as archive:
        packed = {member.name: archive.extractfile(member).read() for member in archive}
    assert packed == {name: (folder / name).read_bytes() for name in found}
    assert "Not verified: DeepRacer on AWS has not imported" in capsys.readouterr().out


def test_metrics_of_all_workers_are_one_file_in_order(dr, exporter):
    put_trained_model(exporter.here, MODEL, numbers=(5,), workers=2)

    assert export(dr) == 0

    (path,) = (exporter.folder / "out/metrics/training").iterdir()
    episodes = json.loads(path.read_text())["metrics"]
    assert [episode["reward_score"] for episode in episodes] == [10, 11, 20, 21, 30, 31]
    assert "iteration" not in episodes[0]
    assert episodes[0]["phase"] == "training"


def test_hyperparameters_are_those_of_the_reference(dr, exporter):
    put_trained_model(
        exporter.here,
        MODEL,
        numbers=(5,),
        hyperparameters={"loss_type": "mean squared error", "clip_range": 0.1, "lr": 0.001},
    )

    assert export(dr) == 0

    values = json.loads((exporter.folder / "out/ip/hyperparameters.json").read_text())
    assert values["loss_type"] == "mean_squared_error"
    assert values["lr"] == 0.001
    assert "clip_range" not in values


@pytest.mark.parametrize(
    ("world", "options", "track", "clockwise"),
    [
        ("reinvent_base", (), "reinvent_base", False),
        ("jyllandsringen_open_cw", (), "jyllandsringen_open", True),
        ("jyllandsringen_open_ccw", (), "jyllandsringen_open", False),
        ("reinvent_base", ("--world", "reInvent2019_wide_cw"), "reInvent2019_wide", True),
    ],
)
def test_the_track_has_no_direction_in_its_name_but_a_boolean(
    dr,
    exporter,
    world,
    options,
    track,
    clockwise,
):
    put_trained_model(exporter.here, MODEL, numbers=(5,), world=world)

    assert export(dr, *options) == 0

    values = yaml.safe_load((exporter.folder / "out/training_params.yaml").read_text())
    assert values["WORLD_NAME"] == track
    assert values["TRACK_DIRECTION_CLOCKWISE"] is clockwise
    assert values["REVERSE_DIR"] is False
    assert "S3_ENDPOINT_URL" not in values


def test_a_track_that_is_unknown_there_is_said(dr, exporter, capsys):
    put_trained_model(exporter.here, MODEL, numbers=(5,), world="my_cellar_cw")

    assert export(dr) == 0

    assert "my_cellar is not a track of DeepRacer on AWS" in capsys.readouterr().out


def test_a_track_whose_direction_nobody_knows_is_refused(dr, exporter, capsys):
    put_trained_model(exporter.here, MODEL, numbers=(5,), world="my_cellar")

    assert export(dr) == 3

    said = capsys.readouterr().err
    assert "does not say in which direction" in said
    assert "--world" in said
    assert not (exporter.folder / "out").exists()


def test_an_archive_alone_and_only_once(dr, exporter, capsys):
    put_trained_model(exporter.here, MODEL, numbers=(5,))

    assert dr("export", "droa", "--out", "mine.tar.gz", "--json") == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    refused = dr("export", "droa", "--out", "mine.tar.gz")

    assert report["archive"] == report["target"] == "mine.tar.gz"
    assert not (exporter.folder / "mine").exists()
    assert refused == 3
    assert "exists already" in capsys.readouterr().err


def test_a_bucket_gets_the_files_without_an_archive(dr, exporter, names):
    put_trained_model(exporter.here, MODEL, numbers=(5,))

    assert dr("export", "droa", "--out", "s3://uploads/for/droa") == 0

    assert set(FILES) < set(names(exporter.there, "for/droa"))
    assert list(exporter.folder.glob("*.tar.gz")) == []


def test_equal_exports_are_equal_archives(dr, exporter):
    put_trained_model(exporter.here, MODEL, numbers=(5,))
    exporter.here.delete([keys.training_metrics(keys.metrics_prefix(MODEL))])

    assert dr("export", "droa", "--out", "a.tar.gz") == 0
    assert dr("export", "droa", "--out", "b.tar.gz") == 0

    one, other = ((exporter.folder / f"{name}.tar.gz").read_bytes() for name in "ab")
    assert one == other


def test_a_model_without_metrics_is_exported_and_that_is_said(dr, exporter, capsys):
    put_trained_model(exporter.here, MODEL, numbers=(5,))
    exporter.here.delete([keys.training_metrics(keys.metrics_prefix(MODEL))])

    assert export(dr) == 0

    assert "no reward graph there" in capsys.readouterr().out


def test_a_model_without_reward_function_is_refused(dr, exporter, capsys):
    put_trained_model(exporter.here, MODEL, numbers=(5,))
    exporter.here.delete([keys.reward_function(MODEL)])

    assert export(dr) == 3

    assert "has no reward_function.py" in capsys.readouterr().err
