"""Maps of a track: right way up, in proportion, start and direction marked."""

import io

import numpy as np
import pytest
from PIL import Image

from drsim.track.track import Track
from drsim.track.worlds import load_track
from drsim.viewing.track_map import picture_map, png_bytes, text_map


@pytest.fixture
def wide() -> Track:
    """A loop 8 m wide and 4 m high, driven counter-clockwise from the middle of its lower side."""
    corners = np.array([[0, -1.5], [3.5, -1.5], [3.5, 1.5], [-3.5, 1.5], [-3.5, -1.5], [0, -1.5]])
    inner, outer = corners * [3 / 3.5, 1 / 1.5], corners * [4 / 3.5, 2 / 1.5]
    return Track("wide", corners * 1.0, inner, outer, closed=True)


def test_a_map_keeps_its_proportions_and_fits(wide):
    lines = text_map(wide, 40, 20)

    assert max(map(len, lines)) == 40
    assert len(lines) == 10  # letters are twice as high as wide
    assert len(text_map(wide, 200, 10)) <= 10


def test_start_and_direction_are_where_they_belong(wide):
    lines = text_map(wide, 40, 20)

    below = next(index for index, line in enumerate(lines) if "S" in line)
    above = next(index for index, line in enumerate(lines) if "←" in line)
    assert above < len(lines) / 2 < below
    assert lines[below].index("S") == pytest.approx(20, abs=1)
    assert "→" in "".join(lines[below])


def test_the_field_inside_the_loop_stays_empty(wide):
    middle = text_map(wide, 40, 20)[5]

    assert middle[12:28].strip() == ""
    assert middle[0] != " "


def test_every_track_gets_a_map_and_a_picture():
    track = load_track("reinvent_base")

    assert len(text_map(track)) <= 16
    assert picture_map(track, 200).shape[1] == 200


def test_a_picture_shows_road_field_and_start(wide):
    picture = picture_map(wide, 220)

    rows, columns = picture.shape[:2]
    assert columns / rows == pytest.approx(8.8 / 4.8, abs=0.02)
    assert picture[rows // 2, columns // 2].mean() > 200  # field
    assert picture[int(rows * 4.15 / 4.8), columns * 6 // 10].mean() < 120  # road below
    below = picture[rows // 2 :, columns // 2]
    assert (below.min(axis=1) == 255).any()  # the white bar


@pytest.mark.parametrize("closed", [True, False])
def test_a_picture_shows_the_road_where_it_is(closed):
    base = load_track("reinvent_base")
    end = None if closed else 60
    track = Track("part", base.center[:end], base.inner[:end], base.outer[:end], closed)

    picture = picture_map(track, 400)

    rows, columns = picture.shape[:2]
    low_x, low_y, high_x, high_y = track.bounds
    pixel_m = max(high_x - low_x + 0.8, high_y - low_y + 0.8) / 400
    x = low_x - 0.4 + pixel_m * (np.arange(columns) + 0.5)
    y = high_y + 0.4 - pixel_m * (np.arange(rows) + 0.5)
    on_road = track.on_road(np.stack(np.meshgrid(x, y), axis=-1))
    field = (picture == (226, 232, 220)).all(axis=2)
    assert np.mean(on_road & field) < 0.002  # edges, which are blurred
    assert np.mean(~on_road & ~field) < 0.03


@pytest.mark.parametrize("shape", [(3, 5), (3, 5, 3)])
def test_a_png_file_holds_the_picture(shape):
    picture = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)

    data = png_bytes(picture)

    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    np.testing.assert_array_equal(Image.open(io.BytesIO(data)), picture)
