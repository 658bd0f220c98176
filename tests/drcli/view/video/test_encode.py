"""Video files: complete or absent, with the right length and size."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from drcli.base.errors import NotAvailable, SettingsError
from drcli.view.video import encode


def frames(count, rows=64, columns=96):
    for k in range(count):
        frame = np.full((rows, columns, 3), 40, np.uint8)
        frame[:, : 2 + k] = (220, 40, 30)
        yield frame


def test_a_video_is_h264_with_as_many_frames_as_were_given(tmp_path):
    av = pytest.importorskip("av", reason="the extra video is not installed")
    path = tmp_path / "lap.mp4"

    with encode.mp4(path, (64, 96), 15) as writer:
        for frame in frames(31):
            writer.add(frame)

    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        assert (stream.width, stream.height, stream.codec_context.name) == (96, 64, "h264")
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert float(stream.duration * stream.time_base) == pytest.approx(31 / 15, abs=1e-3)
        shown = [frame.to_ndarray(format="rgb24") for frame in file.decode(stream)]
    assert len(shown) == 31
    assert np.abs(shown[20][32, 10].astype(int) - (220, 40, 30)).max() < 25
    # A browser plays before it has everything: the index comes first.
    data = path.read_bytes()
    assert 0 < data.index(b"moov") < data.index(b"mdat")
    assert [item.name for item in tmp_path.iterdir()] == ["lap.mp4"]


def test_a_large_video_says_how_its_colours_are_meant(tmp_path):
    # Browsers guess if it does not: findings/pyav_untagged_colours.sh.
    av = pytest.importorskip("av", reason="the extra video is not installed")
    path, bt709, limited = tmp_path / "lap.mp4", 1, 1
    sent = np.full((720, 1280, 3), (40, 160, 60), np.uint8)

    with encode.mp4(path, sent.shape[:2], 15) as writer:
        writer.add(sent)

    with av.open(str(path)) as file:
        context = file.streams.video[0].codec_context
        told = context.colorspace, context.color_primaries, context.color_trc, context.color_range
        [shown] = list(file.decode(video=0))
    assert told == (bt709, bt709, bt709, limited)
    # BT.709: brightness 16 + 219 * (0.2126 R + 0.7152 G + 0.0722 B).
    assert shown.to_ndarray(format="yuv420p")[360, 640] == pytest.approx(125, abs=2)


def test_a_film_that_fails_leaves_nothing_and_keeps_the_old_file(tmp_path):
    pytest.importorskip("av", reason="the extra video is not installed")
    path = tmp_path / "lap.mp4"
    path.write_bytes(b"old")

    def film():
        with encode.mp4(path, (64, 96), 15) as writer:
            for frame in frames(12):
                writer.add(frame)
            raise RuntimeError("midway")

    with pytest.raises(RuntimeError, match="midway"):
        film()

    assert path.read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_without_the_library_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)

    with (
        pytest.raises(NotAvailable, match="needs the package av") as refused,
        encode.mp4(tmp_path / "lap.mp4", (64, 96), 15),
    ):
        pytest.fail("nothing may be written")

    assert "drcli[video]" in refused.value.remedy
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("fps", "count"), [(15, 13), (5, 7), (60, 61), (15, 1)])
def test_the_form_of_a_gif_is_what_its_file_holds(tmp_path, fps, count):
    path = tmp_path / "lap.gif"
    with encode.gif(path, fps) as writer:
        for frame in frames(count):
            writer.add(frame)

    form = encode.form_of(path, encode.Form(96, 64, fps, count))

    with Image.open(path) as picture:
        assert (form.columns, form.rows) == picture.size
        assert form.frames == picture.n_frames
    assert encode.form_of(Path("lap.mp4"), form) == form


def test_a_gif_has_ten_pictures_a_second_and_repeats(tmp_path):
    path = tmp_path / "lap.gif"

    with encode.gif(path, 15) as writer:
        for frame in frames(30, 480, 640):
            writer.add(frame)

    with Image.open(path) as picture:
        assert (picture.width, picture.height) == (400, 300)
        assert picture.n_frames == 20
        assert picture.info["duration"] == 100
        assert picture.info["loop"] == 0


def test_a_folder_that_does_not_exist_is_told(tmp_path):
    with (
        pytest.raises(SettingsError, match="cannot be written") as refused,
        encode.gif(tmp_path / "nowhere" / "lap.gif", 15),
    ):
        pytest.fail("nothing can be written")

    assert "--out" in refused.value.remedy
