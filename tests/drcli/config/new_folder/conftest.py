"""A folder to set up."""

import os

import pytest


@pytest.fixture
def empty(tmp_path, monkeypatch):
    """A folder with nothing in it, current; its name is one that shells trip over."""
    folder = tmp_path / "Müllers Auto $1"
    folder.mkdir()
    for name in os.environ:
        if name.startswith("DR_"):
            monkeypatch.delenv(name)
    monkeypatch.chdir(folder)
    return folder
