"""MJPEG addresses of DeepRacer-for-Cloud's viewer: pictures of a worker that drives."""

import io
import urllib.error
import urllib.request

import pytest
from PIL import Image

from drcli.base.clock import wait_until
from drcli.live.live_record import LiveMessage
from drcli.web import served_folder
from drcli.web.answers import BadRequest
from drcli.web.shared_feed import SharedFeed
from drcli.web.stream_route import MOST_STREAMS, Wanted

CHASE = "/racecar/deepracer/kvs_stream"
CAMERA = "/racecar/camera/zed/rgb/image_rect_color"


def until(is_so):
    """Wait until something is so."""
    assert wait_until(is_so, patience_s=20.0)


def jpeg(width=320, height=240):
    file = io.BytesIO()
    Image.new("RGB", (width, height), "red").save(file, "JPEG")
    return file.getvalue()


class Feed:
    """Workers that show what the test says."""

    made: list["Feed"]

    def __init__(self, directory, on_message, on_gone):
        self.show, self.asked = on_message, []
        self.made.append(self)

    def watch(self, run_id, worker, views, car=None):
        self.asked.append((run_id, worker, tuple(views)))

    def close(self):
        """The console ends."""


@pytest.fixture(autouse=True)  # before the console is made
def feeds(monkeypatch):
    """The feeds that were opened."""
    monkeypatch.setattr(Feed, "made", [], raising=False)
    monkeypatch.setattr(served_folder, "SharedFeed", lambda folder: SharedFeed(folder, Feed))
    return Feed.made


def opened(served, query=""):
    return urllib.request.urlopen(f"{served.url}/stream{query}", timeout=20.0)


def next_picture(stream):
    """Read one part."""
    assert stream.readline() == b"--picture\r\n"
    heads = dict(line.decode().strip().split(": ") for line in iter(stream.readline, b"\r\n"))
    assert heads["Content-Type"] == "image/jpeg"
    data = stream.read(int(heads["Content-Length"]))
    assert stream.readline() == b"\r\n"
    return Image.open(io.BytesIO(data)), heads


def test_a_script_gets_pictures_in_the_size_that_it_wants(served, feeds):
    with opened(served, f"?topic={CHASE}&quality=60&width=480&height=360") as stream:
        assert stream.headers["content-type"] == "multipart/x-mixed-replace; boundary=picture"
        [feed] = feeds
        assert feed.asked == [(0, "sim-0", ("chase",))]
        for second in (10.0, 11.0):
            feed.show(0, "sim-0", LiveMessage("chase", second, jpeg(), 0, 320, 240))
            picture, heads = next_picture(stream)
            assert picture.size == (480, 360)
            assert heads["X-Timestamp"] == f"{second:.3f}"
    until(lambda: feed.asked[-1] == (0, "sim-0", ()))


def test_without_a_size_pictures_are_those_of_the_worker(served, feeds):
    sent = jpeg(160, 120)
    with opened(served, f"?topic={CAMERA}&worker=2") as stream:
        assert feeds[0].asked == [(0, "sim-2", ("camera",))]
        feeds[0].show(0, "sim-0", LiveMessage("camera", 1.0, jpeg(), 0, 320, 240))
        feeds[0].show(0, "sim-2", LiveMessage("chase", 1.0, jpeg(), 0, 320, 240))
        feeds[0].show(0, "sim-2", LiveMessage("camera", 1.0, sent, 0, 160, 120))
        assert next_picture(stream)[0].size == (160, 120)


def test_the_last_picture_before_a_pause_comes_twice_because_browsers_wait_for_another(
    served, feeds
):
    with opened(served) as stream:
        seconds = []
        for second in (1.0, 2.0):
            feeds[0].show(0, "sim-0", LiveMessage("chase", second, jpeg(), 0, 320, 240))
            seconds += [float(next_picture(stream)[1]["X-Timestamp"]) for _ in range(2)]

    assert seconds == [1.0, 1.0, 2.0, 2.0]


def test_a_damaged_picture_is_left_out(served, feeds):
    with opened(served, "?width=32&height=32") as stream:
        feeds[0].show(0, "sim-0", LiveMessage("chase", 1.0, b"no picture", 0, 320, 240))
        feeds[0].show(0, "sim-0", LiveMessage("chase", 2.0, jpeg(), 0, 320, 240))
        assert next_picture(stream)[0].size == (32, 32)


def test_streams_share_one_feed_and_too_many_are_refused(served, feeds):
    streams = [opened(served) for _ in range(MOST_STREAMS)]
    with pytest.raises(urllib.error.HTTPError) as refused:
        opened(served)
    assert refused.value.code == 503
    refused.value.close()
    assert len(feeds) == 1
    for stream in streams:
        stream.close()
    until(lambda: feeds[0].asked[-1] == (0, "sim-0", ()))
    with opened(served):
        assert feeds[0].asked[-1] == (0, "sim-0", ("chase",))


def test_a_script_that_does_not_read_gets_the_newest_picture_later(served, feeds):
    with opened(served) as stream:
        for number in range(300):
            feeds[0].show(0, "sim-0", LiveMessage("chase", number, jpeg(1200, 900), 0, 1200, 900))
        seconds = [float(next_picture(stream)[1]["X-Timestamp"]) for _ in range(1)]
        while seconds[-1] < 299.0:
            seconds.append(float(next_picture(stream)[1]["X-Timestamp"]))
    assert seconds == sorted(seconds)
    assert max(seconds.count(second) for second in seconds) <= 2  # each pause repeats one


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("topic=/racecar/none", "There is no topic"),
        ("topic=" + "x" * 5000, "There is no topic"),
        ("width=0", "width=0 is not from 16 to 1920"),
        ("width=99999", "width=99999 is not"),
        ("height=-5", "height is a whole number"),
        ("height=1e2", "height is a whole number"),
        ("quality=１０", "quality is a whole number"),
        ("quality=100", "quality=100 is not"),
        ("worker=../x", "worker is a whole number"),
        ("worker=999999999999", "worker is a whole number"),
    ],
)
def test_wrong_parameters_are_refused_with_a_sentence(client, feeds, query, said):
    answer = client.get(f"/stream?{query}")

    assert answer.status_code in (400, 404)
    assert answer.json()["error"]["message"].startswith(said)
    assert not feeds


def test_empty_parameters_are_as_those_left_out():
    assert Wanted.of({"width": "", "topic": CHASE}, 3) == Wanted((3, "sim-0", "chase"))
    with pytest.raises(BadRequest):
        Wanted.of({"topic": ""}, 3)


def test_broken_settings_are_said(client, feeds, working_folder):
    (working_folder / "run.env").write_text("DR_WORKERS=several\n")

    answer = client.get("/stream")

    assert answer.status_code == 422
    assert "DR_WORKERS" in answer.json()["error"]["message"]
