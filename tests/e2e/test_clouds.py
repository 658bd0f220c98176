"""A bucket on servers of other people, by each value of DR_CLOUD.

The servers are the programs that serve a bucket of our own, started as anybody would start them.
DR_CLOUD=local is what all the other tests run with.
"""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server
from drcli.config.run_config import Engine, StorageConfig

pytestmark = pytest.mark.nightly

PROFILE = "racer"


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[[Engine], Endpoint]]:
    """Starts a server with an empty bucket in it."""
    started: list[StorageConfig] = []

    def start(engine: Engine) -> Endpoint:
        if engine == "minio" and shutil.which("minio") is None:
            pytest.skip("the program minio is not installed")
        started.append(StorageConfig("local", "races", tmp_path / engine, engine=engine))
        return server.ensure_running(started[-1])

    yield start
    for config in started:
        server.stop(config)


@pytest.fixture
def connect(workspace, tmp_path) -> Callable[..., None]:
    """Lets the workspace use a server, with keys in a profile of the AWS files."""

    def to(endpoint: Endpoint, cloud: str, *, secret: str | None = None) -> None:
        keys = tmp_path / "credentials"
        keys.write_text(
            f"[{PROFILE}]\naws_access_key_id = {endpoint.access_key}\n"
            f"aws_secret_access_key = {secret or endpoint.secret_key}\n"
        )
        (tmp_path / "config").write_text(f"[profile {PROFILE}]\nregion = eu-west-1\n")
        lines = [f"DR_CLOUD={cloud}", "DR_LOCAL_S3_BUCKET=races", f"DR_LOCAL_S3_PROFILE={PROFILE}"]
        if cloud == "aws":  # the address of Amazon's stand-in is no setting of ours
            workspace.environment["AWS_ENDPOINT_URL"] = str(endpoint.url)
        else:
            lines.append(f"DR_REMOTE_MINIO_URL={endpoint.url}")
        (workspace.folder / "system.env").write_text("\n".join(lines) + "\n")
        workspace.environment |= {
            "AWS_SHARED_CREDENTIALS_FILE": str(keys),
            "AWS_CONFIG_FILE": str(tmp_path / "config"),
        }

    return to


@pytest.mark.parametrize("cloud", ["remote", "aws"])
def test_a_model_is_trained_and_looked_at_in_a_bucket_elsewhere(workspace, serve, connect, cloud):
    endpoint = serve("rclone")
    connect(endpoint, cloud)
    workspace.hyperparameters["term_cond_max_episodes"] = 1
    workspace.write_custom_files()

    training = workspace.run("start-training")
    status = workspace.status()
    keys = {info.key for info in S3Bucket(endpoint, "races").list("model/")}

    assert training.returncode == 0, training.stderr
    assert status["state"] == "finished"
    assert len(status["history"]) == 1
    assert {"model/model/.coach_checkpoint", "model/metrics/TrainingMetrics.json"} <= keys
    assert not (workspace.folder / "data" / "s3").exists()


@pytest.mark.parametrize(("cloud", "engine"), [("azure", "moto"), ("remote", "minio")])
def test_files_travel_to_and_from_any_server(workspace, serve, connect, cloud, engine):
    connect(serve(engine), cloud)
    mine = workspace.folder / "custom_files" / "reward_function.py"
    text = mine.read_text()

    up = workspace.run("upload-custom-files")
    mine.unlink()
    down = workspace.run("download-custom-files")

    assert (up.returncode, down.returncode) == (0, 0), up.stderr + down.stderr
    assert mine.read_text() == text


@pytest.mark.parametrize("cloud", ["remote", "aws"])
def test_wrong_keys_are_refused_before_anything_starts(workspace, serve, connect, cloud):
    connect(serve("rclone"), cloud, secret="not-the-secret")

    training = workspace.run("start-training")

    assert training.returncode == 4
    assert "keys" in training.stderr
    assert workspace.record() == {}
