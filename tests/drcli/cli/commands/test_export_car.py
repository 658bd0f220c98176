"""`dr export car` and `dr upload-car-zip` as their callers meet them."""

import io
import json
import tarfile
from pathlib import Path

import pytest

from drcli.convert.frozen_graph import GraphComparison
from memory_bucket import MemoryBucket
from small_model import put_small_model


@pytest.fixture
def here(working_folder: Path, monkeypatch: pytest.MonkeyPatch) -> MemoryBucket:
    """The bucket of the working folder with a model; comparisons find no difference."""
    bucket = MemoryBucket("bucket")
    put_small_model(bucket, "model")
    for module in ("export_model", "transfer_buckets"):
        monkeypatch.setattr(f"drcli.transfer.{module}.open_bucket", lambda *_, **__: bucket)
    monkeypatch.setattr(
        "drcli.checks.compare_on_drive.compare_on_drive",
        lambda *_, frames: GraphComparison(frames, frames, 1e-7),
    )
    return bucket


def test_an_export_is_a_file_in_the_current_folder(dr, here, capsys):
    code = dr("export", "car")

    printed = capsys.readouterr()
    assert code == 0
    assert tarfile.is_tarfile("model.tar.gz")
    assert "Wrote 3_Step-300.ckpt of s3://bucket/model" in printed.out
    assert "200 of 200 frames" in printed.out
    assert "Takes checkpoint 3 of model, the best: score 90.0" in printed.err
    assert "--checkpoint last takes 5" in printed.err
    assert "these actions are the same there: 4 and 3.9 m/s at 0 deg" in printed.err


def test_an_export_as_json_is_one_object(dr, here, capsys):
    code = dr("export", "car", "-b", "--out", "cars", "--json")

    found = json.loads(capsys.readouterr().out)
    assert code == 0
    assert found["files"] == ["cars/model.tar.gz"]
    assert (found["choice"], found["checkpoint"]) == ("best", "3_Step-300.ckpt")
    assert found["actions"][1] == {
        "index": 1,
        "steering_deg": 0.0,
        "speed_mps": 4.0,
        "steering": 0.0,
        "throttle": 1.0,
    }
    assert found["problems"][0]["rule"] == "V-32"


def test_an_export_can_be_checked_again(dr, here, capsys):
    dr("export", "car")
    capsys.readouterr()

    code = dr("export", "car", "--check", "model.tar.gz", "--json")

    found = json.loads(capsys.readouterr().out)
    assert code == 0
    assert (found["ok"], found["errors"]) == (True, [])
    assert len(found["actions"]) == 4
    assert found["overlay"]["world"] == "reinvent_base"
    assert 0 <= found["overlay"]["same_actions"] <= found["overlay"]["frames"] == 20


def test_an_archive_is_checked_outside_a_working_folder(dr, here, tmp_path, monkeypatch, capsys):
    dr("export", "car", "--out", str(tmp_path / "model.tar.gz"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DR_DIR", raising=False)
    capsys.readouterr()

    assert dr("export", "car", "--check", "model.tar.gz") == 0
    assert "With the gray overlay of the car's camera" in capsys.readouterr().out


def test_a_bad_archive_exits_3_with_every_reason(dr, here, capsys):
    with tarfile.open("bad.v1.tar.gz", "w:gz") as tar:
        tar.add("run.env", "checkpoint")

    code = dr("export", "car", "--check", "bad.v1.tar.gz")

    printed = capsys.readouterr()
    assert code == 3
    assert "bad.v1.tar.gz: The car refuses it." in printed.out
    assert "overlay" not in printed.out
    reasons = [line for line in printed.err.splitlines() if line.startswith("Error: ")]
    assert len(reasons) == 4


@pytest.mark.parametrize("text", ["", "text", "PK\x03\x04zip"])
def test_a_file_that_is_no_archive_exits_3(dr, here, capsys, text):
    Path("file.tar.gz").write_text(text)

    assert dr("export", "car", "--check", "file.tar.gz") == 3
    assert capsys.readouterr().err.count("Error: ") == 1


@pytest.mark.parametrize(
    "options", [["-b", "-c", "3"], ["--check", "x.tar.gz", "-b"], ["-c", "-1"]]
)
def test_options_that_contradict_each_other_exit_2(dr, here, options):
    assert dr("export", "car", *options) == 2


def test_a_graph_that_differs_writes_nothing(dr, here, monkeypatch, capsys):
    monkeypatch.setattr(
        "drcli.checks.compare_on_drive.compare_on_drive",
        lambda *_, frames: GraphComparison(frames, 3, 0.5),
    )

    code = dr("export", "car")

    assert code == 3
    assert "the same in 3 of 200 frames" in capsys.readouterr().err
    assert not Path("model.tar.gz").exists()


def test_flags_of_scripts_upload_into_the_local_bucket(dr, here, capsys):
    code = dr("upload-car-zip", "-fL")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out.startswith("Latest checkpoint = 5\n")
    assert here.exists("model-1/carfile.tar.gz")
    assert here.exists("model-1/model.tar.gz")


def test_an_upload_under_its_number_as_json(dr, here, capsys):
    code = dr("upload-car-zip", "-f", "-L", "-n", "-c", "3", "--json")

    found = json.loads(capsys.readouterr().out)
    assert code == 0
    assert "s3://bucket/model-1/model-chk3.tar.gz" in found["files"]


def test_without_a_yes_nothing_is_uploaded(dr, here, capsys, monkeypatch):
    before = [info.key for info in here.list("")]
    monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))

    code = dr("upload-car-zip", "-L")

    assert code == 1
    assert [info.key for info in here.list("")] == before


def test_a_dry_run_uploads_nothing_and_asks_nothing(dr, here, capsys):
    code = dr("upload-car-zip", "-dL")

    assert code == 0
    assert "Would write" in capsys.readouterr().out
    assert not here.exists("model-1/carfile.tar.gz")
