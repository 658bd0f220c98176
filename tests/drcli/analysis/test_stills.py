"""Pictures of an analysis."""

import io
from dataclasses import replace

import pytest
from PIL import Image

from drcli.analysis.analysis import analyse
from drcli.analysis.stills import write_pngs
from drcli.base.errors import SettingsError
from synthetic_plans import healthy
from synthetic_runs import make


def test_pictures_are_written_into_a_new_folder(tmp_path):
    run = make(replace(healthy(3), iterations=4, episodes=8, workers=1)).as_run()

    files = write_pngs(analyse(run), tmp_path / "new" / "pictures")

    names = {path.name for path in files}
    assert {"reward.png", "laps.png", "track.png", "actions.png"} <= names
    for path in files:
        picture = Image.open(io.BytesIO(path.read_bytes()))
        assert picture.width >= 1000
        assert len(picture.convert("RGB").getcolors(1 << 20)) > 20
        title = picture.crop((0, 0, picture.width // 3, 40))
        assert len(title.convert("RGB").getcolors(1 << 20)) > 20


def test_another_file_is_not_replaced_and_nothing_is_written(tmp_path):
    run = make(replace(healthy(3), iterations=2, episodes=4, workers=1)).as_run()
    (tmp_path / "laps.png").write_text("mine")

    with pytest.raises(SettingsError, match="exists already"):
        write_pngs(analyse(run), tmp_path)

    assert [path.name for path in tmp_path.iterdir()] == ["laps.png"]


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    run = make(replace(healthy(3), iterations=2, episodes=4, workers=1)).as_run()
    (tmp_path / "file").touch()

    with pytest.raises(SettingsError, match="cannot be made"):
        write_pngs(analyse(run), tmp_path / "file")
