"""`dr url` as its caller meets it."""

import json

import pytest


def places(printed):
    return {place["name"]: place for place in json.loads(printed)["places"]}


def state_of_server(folder, pid):
    """What the local server leaves behind for later commands."""
    data = folder / "data" / "s3"
    data.mkdir(parents=True)
    state = {"engine": "rclone", "port": 23456, "access_key": "AK1", "secret_key": "s", "pid": pid}
    (data / ".server.json").write_text(json.dumps(state))


def test_a_stopped_server_keeps_its_address_and_is_not_started(dr, working_folder, capsys):
    state_of_server(working_folder, None)

    code = dr("url", "model")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out.splitlines() == [
        "Server: http://127.0.0.1:23456",
        "model:",
        "  s3://bucket/model/",
        "  http://127.0.0.1:23456/bucket/model/",
        f"  {working_folder}/data/s3/bucket/model",
    ]
    assert "is not running" in printed.err
    assert "same address as last time" in printed.err


def test_a_server_that_was_never_started_has_no_address_yet(dr, working_folder, capsys):
    dr("url", "--json")

    report = json.loads(capsys.readouterr().out)
    assert (report["endpoint"], report["running"]) == (None, False)
    assert [place["name"] for place in report["places"]] == [
        "bucket",
        "model",
        "custom-files",
        "metrics",
    ]
    assert report["places"][1]["http"] is None
    assert not (working_folder / "data").exists()


@pytest.mark.parametrize(
    ("what", "s3"),
    [
        ("bucket", "s3://bucket/"),
        ("model", "s3://bucket/model/"),
        ("custom-files", "s3://bucket/custom_files/"),
        ("metrics", "s3://bucket/model/metrics/"),
    ],
)
def test_one_place_is_shown_on_request(dr, working_folder, capsys, what, s3):
    dr("url", what, "--json")

    found = places(capsys.readouterr().out)
    assert list(found) == [what]
    assert found[what]["s3"] == s3


def test_other_servers_have_an_address_and_no_folder(dr, working_folder, capsys):
    (working_folder / "system.env").write_text(
        "DR_CLOUD=remote\nDR_LOCAL_S3_BUCKET=bucket\nDR_REMOTE_MINIO_URL=http://far:9000/\n"
    )

    dr("url", "--json")

    printed = capsys.readouterr().out
    model = places(printed)["model"]
    assert json.loads(printed)["running"] is None
    assert (model["http"], model["folder"]) == ("http://far:9000/bucket/model/", None)


def test_amazon_names_the_bucket_in_the_host(dr, working_folder, capsys):
    (working_folder / "system.env").write_text(
        "DR_CLOUD=aws\nDR_LOCAL_S3_BUCKET=my-bucket\nDR_AWS_APP_REGION=eu-west-1\n"
    )

    dr("url", "--json")

    model = places(capsys.readouterr().out)["model"]
    assert model["http"] == "https://my-bucket.s3.eu-west-1.amazonaws.com/model/"
