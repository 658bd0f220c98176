"""`dr doctor` as its caller meets it."""

import json
import os
import re
import shutil
from datetime import UTC, datetime, timedelta

import pytest

from amazon_server import amazon_server
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.checks.doctor import bucket_health, diagnose, surroundings
from drcli.checks.doctor.libraries import Libraries
from drcli.model.model_store import ModelStore


@pytest.fixture(autouse=True)
def nothing_takes_long(monkeypatch):
    """Nothing takes long: torch is not loaded, and speed is measured with little data."""
    monkeypatch.setattr(diagnose, "ask_libraries", lambda _: Libraries({"number_format": "fp32"}))
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.setattr(surroundings, "_TEST_BYTES", 1 << 20)
    monkeypatch.setattr(bucket_health, "_SPEED_BYTES", (1 << 16, 1 << 17))


@pytest.fixture(scope="module")
def moto():
    with amazon_server() as address:
        yield address


@pytest.fixture
def remote(working_folder, moto, monkeypatch):
    """The bucket of a folder on another server."""
    (working_folder / "system.env").write_text(
        f"DR_CLOUD=remote\nDR_REMOTE_MINIO_URL={moto}\nDR_LOCAL_S3_BUCKET=bucket\n"
    )
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "testing")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "testing")
    bucket = S3Bucket(Endpoint(moto, access_key="testing", secret_key="testing"), "bucket")
    bucket.ensure_exists()
    yield bucket
    bucket.delete([info.key for info in bucket.list("")])


def examined(dr, capsys):
    code = dr("doctor", "--json")
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    return code, report, {finding["subject"]: finding for finding in report["findings"]}


def test_a_folder_without_settings_is_examined_and_stays_empty(dr, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)

    code, report, found = examined(dr, capsys)

    assert code == 0
    assert "no run.env" in found["settings"]["text"]
    assert "bucket" not in found
    assert {"Python", "processor", "GPU", "memory", "disk", "limits"} <= set(found)
    assert report["problems"] == 0
    assert not list(tmp_path.iterdir())


def test_a_bucket_elsewhere_is_examined_and_left_as_it_was(dr, remote, capsys):
    remote.put("model/model/.coach_checkpoint", b"1_Step-2.ckpt")

    code, report, _ = examined(dr, capsys)

    texts = " ".join(each["text"] for each in report["findings"] if each["subject"] == "bucket")
    assert code == 0
    assert re.search(r"answers in \S+ ms, writes \S+ MB/s, reads \S+ MB/s", texts)
    assert "work in all 4 folders" in texts
    assert "agrees" in texts
    assert [info.key for info in remote.list("")] == ["model/model/.coach_checkpoint"]


def test_the_upload_bucket_is_examined_too(dr, remote, working_folder, moto, capsys):
    with (working_folder / "system.env").open("a") as file:
        file.write(f"DR_UPLOAD_S3_BUCKET=missing\nDR_UPLOAD_S3_ENDPOINT_URL={moto}\n")

    code, _, found = examined(dr, capsys)

    assert code == 4
    assert "'missing' does not exist" in found["upload bucket"]["text"]
    assert found["upload bucket"]["remedy"]


def test_a_server_that_is_away_is_a_problem_of_the_bucket_alone(dr, remote, working_folder, capsys):
    (working_folder / "system.env").write_text(
        "DR_CLOUD=remote\nDR_REMOTE_MINIO_URL=http://127.0.0.1:9\n"
    )

    code, report, found = examined(dr, capsys)

    assert code == 4
    assert "no server answers" in found["bucket"]["text"]
    assert report["seconds"] < 10


@pytest.mark.parametrize(("minutes", "state"), [(0, "ok"), (7, "warning"), (20, "problem")])
def test_a_wrong_clock_is_found(dr, remote, capsys, monkeypatch, minutes, state):
    said = datetime.now(UTC) - timedelta(minutes=minutes)
    monkeypatch.setattr("drcli.checks.doctor.bucket_health.parsedate_to_datetime", lambda _: said)

    _, report, _ = examined(dr, capsys)

    ours = [each for each in report["findings"] if each["subject"] == "bucket"]
    [clock] = [each for each in ours if "clock" in each["text"]]
    assert clock["state"] == state


def test_wrong_settings_are_listed_and_the_bucket_is_left_alone(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("DR_WORKERS=many\nDR_RACE_TYPE=SWIMMING\n")

    code, report, _ = examined(dr, capsys)

    texts = [each["text"] for each in report["findings"] if each["subject"] == "settings"]
    assert code == 3
    assert any("DR_WORKERS" in text for text in texts)
    assert any("DR_RACE_TYPE" in text for text in texts)
    assert not (working_folder / "data").exists()


def test_a_page_for_people_fits_a_terminal_of_80_columns(dr, remote, capsys, monkeypatch):
    monkeypatch.setattr("drcli.cli.terminal.columns", lambda: 80)

    assert dr("doctor") == 0

    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert len(lines) <= 30
    assert lines[-1].startswith("No problems, ")


def test_no_key_is_printed(dr, remote, capsys, monkeypatch):
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKCANARYCANARY")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret-canary")

    dr("doctor", "--json")

    printed = "".join(capsys.readouterr())
    assert "CANARY" not in printed
    assert "secret-canary" not in printed
    assert os.environ["AWS_SECRET_ACCESS_KEY"] == "secret-canary"


def test_the_owner_of_the_model_is_named(dr, remote, capsys, monkeypatch):
    from drcli.model import lease

    lease.take(ModelStore(remote, "model"), "session")

    _, report, _ = examined(dr, capsys)

    assert any("being trained by" in each["text"] for each in report["findings"])
    assert remote.exists("runs/model/lease.json")
