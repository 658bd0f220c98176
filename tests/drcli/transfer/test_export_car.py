"""The checkpoint that is exported, and the archives that come out, in files and buckets."""

import tarfile
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from drcli.base.errors import ProblemsError, SettingsError, StorageError
from drcli.bucket.bucket import ObjectDamaged
from drcli.config.loading import load_settings
from drcli.config.run_config import DriveConfig
from drcli.convert.frozen_graph import GraphComparison
from drcli.model import keys
from drcli.transfer.export_car import (
    CarExport,
    archive_path,
    export_car,
    plan_car_upload,
    upload_archive,
    upload_names,
    write_archive,
)
from drcli.transfer.export_model import ExportSource, Selection, read_export_source
from drcli.transfer.upload import Retention
from memory_bucket import MemoryBucket
from reference_model import LAST, reference_model
from small_model import put_small_model

from .conftest import no_bar

EQUAL = GraphComparison(200, 200, 1e-7)


@pytest.fixture
def here(working_folder: Path, monkeypatch: pytest.MonkeyPatch) -> MemoryBucket:
    """The bucket of the working folder, with a model."""
    (working_folder / "system.env").write_text("DR_UPLOAD_S3_BUCKET=uploads\n")
    (working_folder / "run.env").write_text(
        "DR_WORLD_NAME=reinvent_base\nDR_LOCAL_S3_MODEL_PREFIX=team/model.1\n"
        "DR_UPLOAD_S3_PREFIX=race/upload\n"
    )
    bucket = MemoryBucket("bucket")
    put_small_model(bucket, "team/model.1")
    for module in ("export_model", "transfer_buckets"):
        monkeypatch.setattr(f"drcli.transfer.{module}.open_bucket", lambda *_, **__: bucket)
    return bucket


@pytest.fixture
def there(here: MemoryBucket, monkeypatch: pytest.MonkeyPatch) -> MemoryBucket:
    """The bucket of uploads."""
    bucket = MemoryBucket("uploads")
    monkeypatch.setattr(
        "drcli.transfer.transfer_buckets.open_upload_bucket", lambda *_, **__: bucket
    )
    return bucket


def settings() -> Any:
    return load_settings(Path())


def source(choice: Any = "last", prefix: str | None = None) -> ExportSource:
    return read_export_source(settings(), Selection(choice, prefix))


def exported(comparison: GraphComparison = EQUAL, **selection: Any) -> CarExport:
    def compare(race: DriveConfig, made: ExportSource, graph: bytes) -> GraphComparison:
        return comparison

    return export_car(settings(), source(**selection), "model-1.tar.gz", compare)


@pytest.mark.parametrize(
    ("choice", "name"),
    [("last", "5_Step-500.ckpt"), ("best", "3_Step-300.ckpt"), (3, "3_Step-300.ckpt")],
)
def test_the_chosen_checkpoint_is_read(here, choice, name):
    found = source(choice)

    assert found.chosen.name == name
    assert found.weights == here.get(f"team/model.1/model/{name}.safetensors")
    assert found.origin == f"s3://bucket/team/model.1/model/{name}.safetensors"
    assert found.design.metadata.neural_network == "COMPACT_CONVOLUTIONAL_NETWORK"
    assert found.world == "reinvent_base"


def test_another_model_is_read_by_its_prefix(here):
    put_small_model(here, "other", numbers=(1,))

    assert source(prefix="other").url == "s3://bucket/other"


@pytest.mark.parametrize(
    ("gone", "text"),
    [
        ("model/model_metadata.json", "model_metadata.json does not exist"),
        ("ip/hyperparameters.json", "hyperparameters.json does not exist"),
        ("model/5_Step-500.ckpt.safetensors", "5_Step-500.ckpt.safetensors is missing"),
    ],
)
def test_a_missing_file_is_named(here, gone, text):
    here.delete([f"team/model.1/{gone}"])

    with pytest.raises(SettingsError, match=text):
        source()


def test_damaged_weights_are_refused(here):
    key = keys.checkpoint_tensors("team/model.1", "5_Step-500.ckpt")
    here.put(key, here.get(key)[:-1])

    with pytest.raises(ObjectDamaged, match=r"5_Step-500\.ckpt"):
        source()


def test_the_frozen_graph_of_the_reference_is_packed_as_it_lies_there(here):
    files = reference_model()
    for name, data in files.items():
        here.put(f"theirs/{name}", data)

    found = exported(prefix="theirs")

    assert found.report.checkpoint == LAST
    with tarfile.open(fileobj=BytesIO(found.archive)) as archive:
        member = archive.extractfile("agent/model.pb")
        assert member is not None
        assert member.read() == files["model/model_3.pb"]


def test_without_its_frozen_graph_a_checkpoint_of_the_reference_gets_another(here):
    for name, data in reference_model().items():
        if not name.endswith(".pb"):
            here.put(f"theirs/{name}", data)

    assert exported(prefix="theirs").report.checkpoint == LAST


def test_a_model_that_does_not_exist_is_refused(here):
    with pytest.raises(SettingsError, match="No checkpoint file available"):
        source(prefix="nobody")


def test_the_report_says_what_the_car_does_differently(here):
    report = exported().report

    assert (report.source, report.checkpoint) == ("s3://bucket/team/model.1", "5_Step-500.ckpt")
    assert [action.throttle for action in report.actions] == [0.475, 1.0, 1.0, 0.475]
    assert [problem.rule for problem in report.problems] == ["V-32"]
    assert (report.frames, report.same_actions, report.world) == (200, 200, "reinvent_base")


def test_the_graph_is_compared_on_the_track_of_the_model_if_it_is_installed(here):
    worlds = []

    def compare(race: DriveConfig, made: ExportSource, graph: bytes) -> GraphComparison:
        worlds.append(race.world_name)
        return EQUAL

    for world in ("paddle", "not_installed"):
        start = b'{"seed": 7, "settings": {"DR_WORLD_NAME": "%s"}}' % world.encode()
        here.put(keys.training_start("team/model.1"), start)
        export_car(settings(), source(), "model.tar.gz", compare)

    assert worlds == ["paddle", "reinvent_base"]


@pytest.mark.parametrize(
    ("files", "text"),
    [
        ({"parameters": {"stack_size": 3}}, "stack_size=3"),
        ({"sensor": ["FRONT_FACING_CAMERA", "DISCRETIZED_SECTOR_LIDAR"]}, "DISCRETIZED"),
        (
            {
                "action_space_type": "continuous",
                "action_space": {
                    "steering_angle": {"low": -30, "high": 20},
                    "speed": {"low": 1, "high": 2},
                },
            },
            "from -30 to 20",
        ),
    ],
)
def test_what_the_car_cannot_drive_is_refused(here, files, text):
    put_small_model(here, "bad", **files)

    with pytest.raises(ProblemsError, match=text):
        exported(prefix="bad")


@pytest.mark.parametrize(
    "comparison", [GraphComparison(200, 199, 1e-7), GraphComparison(200, 200, 2e-4)]
)
def test_a_graph_that_differs_is_refused(here, comparison):
    with pytest.raises(SettingsError, match="does not compute what its weights do"):
        exported(comparison)


def test_the_archive_is_written_as_a_file(here, tmp_path):
    path = archive_path(tmp_path / "new" / "cars", "model.1")

    report = write_archive(exported(), path)

    assert report.files == [str(tmp_path / "new" / "cars" / "model-1.tar.gz")]
    with tarfile.open(path) as tar:
        assert sorted(tar.getnames()) == ["agent/model.pb", "model_metadata.json"]


def test_an_older_archive_is_replaced_whole(here, tmp_path):
    path = tmp_path / "model.tar.gz"
    path.write_bytes(b"older")

    write_archive(exported(), path)

    assert tarfile.is_tarfile(path)
    assert list(tmp_path.glob(".*")) == []


@pytest.mark.parametrize("name", ["my.model.tar.gz", "model.zip", "my model.tar.gz"])
def test_a_file_name_that_the_car_changes_is_refused(tmp_path, name):
    with pytest.raises(ProblemsError, match="is not a name that the car keeps"):
        archive_path(tmp_path / name, "model")


def test_a_folder_that_cannot_be_created_is_named(here, tmp_path):
    (tmp_path / "file").write_text("")

    with pytest.raises(SettingsError, match="cannot be created"):
        write_archive(exported(), tmp_path / "file" / "model.tar.gz")


def test_an_upload_has_both_names_that_scripts_look_for(here, there):
    target = plan_car_upload(settings(), None, local=False, dry_run=False)
    names = upload_names(source(), numbered=True)

    report = upload_archive(exported(), target, names, no_bar, dry_run=False)

    uploaded = [info.key for info in there.list("")]
    assert uploaded == [
        "race/upload/carfile.tar.gz",
        "race/upload/team-model-1-chk5.tar.gz",
        "race/upload/team-model-1.tar.gz",
    ]
    assert {there.get(key) for key in uploaded} == {exported().archive}
    assert sorted(report.files) == [f"s3://uploads/{key}" for key in uploaded]


def test_numbered_archives_with_the_name_of_version_0_1_0_are_deleted_too(here, there):
    old, others = "race/upload/model-1-chk2.tar.gz", "race/upload/model-1.tar.gz"
    for key in (old, others):
        there.put(key, b"archive")
    keep = Retention.of("last", 0)
    target = plan_car_upload(settings(), None, local=False, dry_run=False, retention=keep)
    names = upload_names(source(), numbered=True)

    report = upload_archive(exported(), target, names, no_bar, dry_run=False)

    assert report.deleted == ["model-1-chk2.tar.gz"]
    there_now = {info.key for info in there.list("")}
    assert old not in there_now
    assert {others, "race/upload/team-model-1-chk5.tar.gz"} <= there_now


def test_with_a_prefix_the_archive_goes_below_that_model(here, there):
    put_small_model(here, "other")

    target = plan_car_upload(settings(), "other", local=True, dry_run=False)

    assert target.url == "s3://bucket/other"


def test_a_dry_run_writes_nothing(here, there):
    there.put = _forbidden
    target = plan_car_upload(settings(), None, local=False, dry_run=True)

    report = upload_archive(exported(), target, ["carfile.tar.gz"], no_bar, dry_run=True)

    assert report.dry_run
    assert there.list("") == []


def test_a_bucket_that_takes_no_objects_is_found_before_anything_is_made(here, there):
    there.put = _forbidden

    with pytest.raises(StorageError, match="forbidden"):
        plan_car_upload(settings(), None, local=False, dry_run=False)


def test_without_a_bucket_for_uploads_the_error_says_what_to_set(here):
    (Path("system.env")).write_text("")

    with pytest.raises(SettingsError, match="No upload bucket defined"):
        plan_car_upload(settings(), None, local=False, dry_run=False)


def _forbidden(*_: object, **__: object) -> None:
    raise StorageError("forbidden", remedy="Get permission.")
