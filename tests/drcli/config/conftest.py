"""A folder to load settings from."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import pytest

from drcli.base.errors import SettingsError
from drcli.base.json_record import from_json, json_default
from drcli.config.loading import load_settings
from drcli.config.run_config import RunConfig
from drcli.config.settings import Settings


class Folder:
    """A folder with a run.env and a system.env."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.write("system.env", "")

    def write(self, name: str, text: str | bytes) -> None:
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text if isinstance(text, bytes) else text.encode())

    def load(self, run: str | bytes, **options) -> Settings:
        self.write("run.env", run)
        return load_settings(self.path, **{"environ": {}, **options})

    def refusal(self, run: str | bytes, **options) -> SettingsError:
        with pytest.raises(SettingsError) as caught:
            self.load(run, **options)
        return caught.value


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


@pytest.fixture(scope="session")
def travelled() -> Callable[[RunConfig], RunConfig]:
    """What another process gets of a run."""

    def travel(config: RunConfig) -> RunConfig:
        return from_json(RunConfig, json.loads(json.dumps(asdict(config), default=json_default)))

    return travel
