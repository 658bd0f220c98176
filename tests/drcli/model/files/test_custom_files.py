"""Where the racer's three files are found."""

import shlex
from pathlib import Path

import pytest

from drcli.base.errors import SettingsError
from drcli.model.files.custom_files import find


@pytest.mark.parametrize("look", ["is_file", "read_bytes"])
def test_a_file_that_may_not_be_read_is_named(racer, monkeypatch, look):
    def refuse(path: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    settings = racer.settings()
    monkeypatch.setattr(Path, look, refuse)  # root may read everything

    with pytest.raises(
        SettingsError, match=r"reward_function\.py: cannot be read \(Permission denied"
    ) as refusal:
        find(settings.custom_files, None)

    path = racer.folder / "custom_files" / "reward_function.py"
    assert f"`chmod u+r {shlex.quote(str(path))}`" in refusal.value.remedy
