"""A fake DeepRacer on AWS, a user of it, and a model that it accepts."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from droa_models import Files, accepted_model, write_files
from droa_server import PASSWORD, USER, FakeDroa


@pytest.fixture
def fake() -> Iterator[FakeDroa]:
    server = FakeDroa()
    yield server
    server.stop()


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The home folder of the user, without keys of anything else."""
    folder = tmp_path / "home"
    folder.mkdir()
    monkeypatch.setenv("HOME", str(folder))
    for name in ("AWS_PROFILE", "AWS_ENDPOINT_URL", "AWS_ACCESS_KEY_ID", "HTTPS_PROXY"):
        monkeypatch.delenv(name, raising=False)
    return folder


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The seconds that commands would have waited; they do not."""
    waited: list[float] = []
    monkeypatch.setattr("drcli.cli.droa_options.pause", waited.append)
    return waited


@pytest.fixture
def droa(
    dr: Callable[..., int],
    fake: FakeDroa,
    home: Path,
    pauses: list[float],
    working_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[..., int]:
    """Runs a droa command line of a user whose settings name the fake; its exit code."""
    with (working_folder / "system.env").open("a") as file:
        file.write(
            f"DR_DROA_URL={fake.url}/\nDR_DROA_USERNAME={USER}\n"
            f"DR_DROA_AWS_ENDPOINT_URL={fake.url}\n"
        )
    monkeypatch.setattr("drcli.cli.prompts.secret", lambda question, remedy: PASSWORD)
    return dr


@pytest.fixture
def model() -> Files:
    return accepted_model()


@pytest.fixture
def laid(tmp_path: Path) -> Callable[[Files], Path]:
    """Writes files into a folder, and returns it."""
    return lambda files: write_files(tmp_path / "my-model", files)
