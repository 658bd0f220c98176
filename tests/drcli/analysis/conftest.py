"""Trainings as files, and how they are read."""

import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from drcli.analysis.model_source import open_model
from drcli.analysis.read_run import read_run, run_of
from drcli.analysis.run import Run
from drcli.config.loading import load_settings
from drcli.config.settings import Settings

SHARED = Path(__file__).parents[4] / "shared"


@pytest.fixture(scope="session")
def libraries() -> Any:
    """deepracer-utils, which warns about itself while it is loaded."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from drcli.analysis.run import deepracer_logs

        return deepracer_logs()


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    """Of a working folder without a model."""
    folder = tmp_path / "racer"
    folder.mkdir(exist_ok=True)
    (folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=team/model-1\n")
    return load_settings(folder, environ={})


@pytest.fixture
def read(settings: Settings, libraries: Any) -> Callable[..., Run]:
    """Reads a model."""

    def reading(what: Path | str | None, **options: Any) -> Run:
        name = None if what is None else str(what)
        return run_of(
            open_model(settings, name, **options), settings.tracks_folder, settings.directory
        )

    return reading


@pytest.fixture(scope="session")
def reference_run(
    reference_runs: Path, libraries: Any, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Run]:
    """Reads a recorded training of the reference, each once."""
    settings = load_settings(tmp_path_factory.mktemp("racer"), contents={"run.env": b""})

    @cache
    def reading(name: str) -> Run:
        return read_run(settings, str(reference_runs / name))

    return reading


@pytest.fixture(scope="session")
def reference_runs() -> Path:
    """Recorded trainings of the reference."""
    folder = SHARED / "reference-runs"
    if not folder.is_dir():
        pytest.skip("The recorded trainings are not part of the repository.")
    return folder
