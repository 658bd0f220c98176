"""Whole videos: of files and evaluations, on the right track, with what is known about them."""

import itertools
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from drcli.base.errors import SettingsError
from drcli.config.run_config import ModelConfig
from drcli.config.value_types import shell_color
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.evaluation_task import RaceRecording, RecordedObjects
from drcli.view.video import encode, overlay
from drcli.view.video.make_video import VideoOptions, chosen_laps, frames_of, plan_of, refuse_file
from drcli.view.video.recorded_lap import find_world, read_laps
from drcli.view.video.trace_source import trace_of_evaluation, trace_of_file, trace_of_iteration
from drcli.view.video.video_job import CAMERAS, Defaults, PolicyOptions, make_video, put_videos
from drsim.track.worlds import load_track
from drsim.viewing.world_view import WorldView
from memory_bucket import MemoryBucket
from recorded_drives import trace_csv, trace_rows

TRACK = load_track("reinvent_base")
STAMPS = ("20260102030405", "20260102030506")


@pytest.fixture
def bucket():
    made = MemoryBucket()
    for stamp, speed in zip(STAMPS, (1.0, 2.0), strict=True):
        made.put(keys.evaluation_trace("m", stamp), trace_csv(trace_rows(TRACK, speed_mps=speed)))
    made.put("m/evaluation-20260909090909/evaluation-simtrace/notes.txt", b"no trace")
    made.put("m/training-simtrace/4-iteration.csv", trace_csv(trace_rows(TRACK, rows=5)))
    made.put("w/1/training-simtrace/0-iteration.csv", trace_csv(trace_rows(TRACK, rows=7)))
    return made


@pytest.fixture
def defaults(tmp_path):
    return Defaults(
        ModelConfig("m", "m/metrics", "progress", 1, "", ""),
        tmp_path / "tracks",
        "willow",
        "Grace",
        "Orange",
    )


def test_the_newest_evaluation_is_filmed_unless_another_one_is_named(bucket):
    newest = trace_of_evaluation(ModelStore(bucket, "m"), None)
    named = trace_of_evaluation(ModelStore(bucket, "m"), STAMPS[0])

    assert STAMPS[1] in newest.origin
    assert newest.laps[0].speed_mps[0] == 2.0
    assert named.laps[0].speed_mps[0] == 1.0


def test_a_model_without_that_trace_is_told_what_there_is(bucket):
    bucket.put("other/model/model_metadata.json", b"{}")
    with pytest.raises(SettingsError, match="no stored evaluation") as refused:
        trace_of_evaluation(ModelStore(bucket, "other"), None)
    assert "--checkpoint" in refused.value.remedy
    with pytest.raises(SettingsError, match="no evaluation 20260909090909") as refused:
        trace_of_evaluation(ModelStore(bucket, "m"), "20260909090909")
    assert STAMPS[1] in refused.value.remedy
    with pytest.raises(SettingsError, match="no trace of iteration 3"):
        trace_of_iteration(ModelStore(bucket, "m"), 3, 0)


def test_an_unknown_model_is_no_model_without_an_evaluation(bucket):
    with pytest.raises(SettingsError, match="There is no model another in s3://") as refused:
        trace_of_evaluation(ModelStore(bucket, "another"), None)
    assert "dr-list-models" in refused.value.remedy


def test_the_last_race_as_an_opponent_is_found(bucket):
    rival = keys.opponent_trace("rival")
    bucket.put(rival, trace_csv(trace_rows(TRACK, rows=6)))
    bucket.put(keys.recording_of(rival), recording().encode())
    bucket.put(keys.opponent_trace("m"), trace_csv(trace_rows(TRACK, rows=9)))

    only = trace_of_evaluation(ModelStore(bucket, "rival"), None)
    named = trace_of_evaluation(ModelStore(bucket, "m"), "opponent")

    assert (only.origin, only.stem) == ("the last race as the opponent", "rival-opponent")
    assert only.recording == recording()
    assert (len(only.laps[0].time_s), len(named.laps[0].time_s)) == (6, 9)
    assert STAMPS[1] in trace_of_evaluation(ModelStore(bucket, "m"), None).origin


def test_a_model_that_was_no_opponent_is_told_so(bucket):
    with pytest.raises(SettingsError, match="has not raced as an opponent"):
        trace_of_evaluation(ModelStore(bucket, "m"), "opponent")
    with pytest.raises(SettingsError, match="There is no model another"):
        trace_of_evaluation(ModelStore(bucket, "another"), "opponent")


def test_a_film_of_a_file_in_a_parent_folder_has_no_dots_in_its_name(tmp_path, monkeypatch):
    (tmp_path / "lap.csv").write_bytes(trace_csv(trace_rows(TRACK, rows=3)))
    (tmp_path / "inner").mkdir()
    monkeypatch.chdir(tmp_path / "inner")

    assert trace_of_file(Path("../lap.csv")).stem == "lap"


def test_an_iteration_of_any_worker_is_found(bucket):
    assert len(trace_of_iteration(ModelStore(bucket, "m"), 4, 0).laps[0].time_s) == 5
    assert len(trace_of_iteration(ModelStore(bucket, "w"), 0, 1).laps[0].time_s) == 7
    with pytest.raises(SettingsError, match="of worker 2"):
        trace_of_iteration(ModelStore(bucket, "w"), 0, 2)


def test_what_was_recorded_beside_a_trace_is_used(bucket):
    trace = keys.evaluation_trace("m", STAMPS[1])
    bucket.put(keys.recording_of(trace), recording().encode())

    found = trace_of_evaluation(ModelStore(bucket, "m"), None)

    assert found.recording == recording()
    assert found.laps[0].objects.shape == (31, 1, 3)


def test_a_damaged_recording_is_told_and_the_rest_shown(bucket):
    trace = keys.evaluation_trace("m", STAMPS[1])
    bucket.put(keys.recording_of(trace), b'{"world": 7}')

    found = trace_of_evaluation(ModelStore(bucket, "m"), None)

    assert found.recording is None
    assert "recording.json is damaged" in found.notes[0]
    assert found.laps


def recording():
    return RaceRecording(
        "reinvent_base",
        False,
        "OBJECT_AVOIDANCE",
        "m",
        "3_Step-99.ckpt",
        "Ada",
        "Blue",
        ["box_obstacle"],
        [RecordedObjects(0, [[[1.0, 2.0, 0.5]]])],
    )


def test_the_track_is_found_by_length_and_place(tmp_path):
    laps, _ = read_laps(trace_csv(trace_rows(TRACK, rows=150)), "lap.csv")

    assert find_world(laps, "willow", None, "lap.csv").name in ("reinvent_base", "reinvent_carpet")
    assert find_world(laps, "reinvent_wood", None, "lap.csv").name == "reinvent_wood"
    with pytest.raises(SettingsError, match=r"no installed one of 99\.00 m fits") as refused:
        find_world([changed(laps[0], track_length_m=99.0)], "willow", tmp_path, "lap.csv")
    assert "--world" in refused.value.remedy


def changed(lap, **fields):
    from dataclasses import replace

    return replace(lap, **fields)


def test_the_best_lap_is_complete_without_resets_and_then_fast():
    slow = trace_rows(TRACK, episode=0, rows=30, status="lap_complete")
    fast = trace_rows(TRACK, episode=1, rows=20, status="lap_complete")
    broken = trace_rows(TRACK, episode=2, rows=10, status="off_track")
    fast[5]["episode_status"] = "off_track"
    laps, _ = read_laps(trace_csv(slow, fast, broken), "lap.csv")

    assert [lap.number for lap in chosen_laps(laps, "best", "")] == [0]
    assert [lap.number for lap in chosen_laps(laps[1:], "best", "")] == [1]
    assert [lap.number for lap in chosen_laps(laps, "all", "")] == [0, 1, 2]
    assert [lap.number for lap in chosen_laps(laps, "2", "")] == [2]
    with pytest.raises(SettingsError, match="no episode 7"):
        chosen_laps(laps, "7", "lap.csv")


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("notes.mp4", "exists already"),
        ("lap.avi", "ends neither"),
        ("no/lap.mp4", "does not exist"),
    ],
)
def test_no_other_file_is_replaced(tmp_path, name, what):
    (tmp_path / "notes.mp4").write_text("my notes about the race")

    with pytest.raises(SettingsError, match=what):
        refuse_file(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "color"),
    [("Blue", (68, 95, 229)), ("f1_car_20ff40", (32, 255, 64)), ("f1_car_x", (224, 26, 37))],
)
def test_shell_colors(name, color):
    assert tuple(map(round, shell_color(name))) == color


def test_a_file_becomes_a_film_with_ghosts_and_boxes(tmp_path, defaults):
    folder = tmp_path / "evaluation-20260102030405"
    (folder / "evaluation-simtrace").mkdir(parents=True)
    path = folder / "evaluation-simtrace" / "0-iteration.csv"
    path.write_bytes(trace_csv(trace_rows(TRACK, rows=8), trace_rows(TRACK, episode=1, rows=4)))
    (folder / "recording.json").write_bytes(recording().encode())
    out = tmp_path / "lap.gif"

    report = make_video(
        defaults, no_bucket, trace_of_file(path), VideoOptions(ghosts=1, color=""), [("film", out)]
    )

    assert (report.world, report.frames, report.fps) == ("reinvent_base", 6, 10)
    assert [episode.episode for episode in report.episodes] == [0]
    assert report.notes == []
    with Image.open(out) as picture:
        assert np.asarray(picture.convert("RGB")).std() > 30


def test_the_title_of_a_filmed_file_tells_no_folders_of_this_machine(
    tmp_path, defaults, monkeypatch
):
    path = tmp_path / "evaluation-20260102030405" / "evaluation-simtrace" / "0-iteration.csv"
    path.parent.mkdir(parents=True)
    path.write_bytes(trace_csv(trace_rows(TRACK, rows=4)))
    shown = []
    draw = overlay.Overlay.draw

    def noted(self, *given):
        shown.append(self._titles.what)
        return draw(self, *given)

    monkeypatch.setattr(overlay.Overlay, "draw", noted)

    make_video(
        defaults, no_bucket, trace_of_file(path), VideoOptions(), [("film", tmp_path / "lap.gif")]
    )

    assert set(shown) == {"evaluation-20260102030405-0"}


def test_each_car_of_a_race_of_two_models_has_its_own_colour(tmp_path, defaults, monkeypatch):
    rows = trace_rows(TRACK, rows=4)
    recorded = replace(
        recording(),
        color="Orange",
        other_color="Blue",
        shapes=["race_car"],
        episodes=[RecordedObjects(0, [[[1.0, 2.0, 0.5]]])],
    )
    folder = tmp_path / "evaluation-20260102030405"
    (folder / "evaluation-simtrace").mkdir(parents=True)
    path = folder / "evaluation-simtrace" / "0-iteration.csv"
    path.write_bytes(trace_csv(rows))
    (folder / "recording.json").write_bytes(recorded.encode())
    colors = set()

    def frame(self, lens, things):
        colors.add(tuple(thing.color for thing in things))
        return np.zeros((480, 640, 3), np.uint8)

    monkeypatch.setattr(WorldView, "frame", frame)

    make_video(
        defaults,
        no_bucket,
        trace_of_file(path),
        VideoOptions(color=""),
        [("film", tmp_path / "lap.gif")],
    )

    assert colors == {(shell_color("Orange"), shell_color("Blue"))}


def test_nothing_is_filmed_for_a_gif_that_takes_no_more(tmp_path, defaults, monkeypatch):
    monkeypatch.setattr(encode, "MOST_GIF_PICTURES", 3)
    path = tmp_path / "0-iteration.csv"
    path.write_bytes(trace_csv(trace_rows(TRACK, rows=8), trace_rows(TRACK, episode=1, rows=4)))
    made = []
    monkeypatch.setattr(
        WorldView,
        "frame",
        lambda self, lens, things: made.append(1) or np.zeros((480, 640, 3), "u1"),
    )

    report = make_video(
        defaults,
        no_bucket,
        trace_of_file(path),
        VideoOptions(episode="all", fps=10, color=""),
        [("film", tmp_path / "lap.gif")],
    )

    assert (report.frames, report.seconds, len(made)) == (3, 0.3, 3)
    assert [episode.episode for episode in report.episodes] == [0]


@pytest.mark.parametrize(
    ("fps", "most", "seconds", "note"),
    [
        (10, 3, "0.3 s (3 frames)", "A GIF ends after 0 s; the episodes take 4 s"),
        (10, 20, "2.0 s (20 frames)", "A GIF ends after 2 s; the episodes take 4 s"),
        (15, 20, "2.0 s (30 frames)", "A GIF ends after 2 s; the episodes take 4 s"),
        (10, 50, "3.6 s (36 frames)", ""),
    ],
)
def test_what_is_announced_of_a_gif_is_no_more_than_it_holds(
    tmp_path, defaults, monkeypatch, fps, most, seconds, note
):
    monkeypatch.setattr(encode, "MOST_GIF_PICTURES", most)
    path = tmp_path / "0-iteration.csv"
    path.write_bytes(trace_csv(*(trace_rows(TRACK, episode=n, rows=16) for n in range(3))))
    monkeypatch.setattr(WorldView, "frame", lambda *_: np.zeros((480, 640, 3), "u1"))
    options, trace = VideoOptions(episode="all", fps=fps, color=""), trace_of_file(path)
    gif, mp4 = tmp_path / "lap.gif", tmp_path / "lap.mp4"

    announced = plan_of(trace, options, [gif])
    report = make_video(defaults, no_bucket, trace, options, [("film", gif)])

    assert announced.startswith(f"Filming {seconds} of ")
    assert seconds.startswith(f"{report.seconds} s")
    assert [each for each in report.notes if "GIF" in each] == (
        [f"{note} (an MP4 shows all of it)."] if note else []
    )
    assert frames_of(trace, options, [gif, mp4]) >= 36


@pytest.mark.parametrize(("most", "frames"), [(1, 10), (2, 20), (9, 36), (None, 36)])
def test_a_film_ends_at_its_limit_and_says_so(tmp_path, defaults, monkeypatch, most, frames):
    path = tmp_path / "0-iteration.csv"
    path.write_bytes(trace_csv(*(trace_rows(TRACK, episode=n, rows=16) for n in range(3))))
    monkeypatch.setattr(WorldView, "frame", lambda *_: np.zeros((480, 640, 3), "u1"))
    options = VideoOptions(episode="all", fps=10, color="", most_seconds=most)
    trace = trace_of_file(path)

    report = make_video(defaults, no_bucket, trace, options, [("film", tmp_path / "lap.gif")])

    assert report.frames == frames_of(trace, options, [Path(report.file)]) == frames
    said = [note for note in report.notes if "film ends" in note]
    assert [f"after {most} s; the episodes take 4 s" in note for note in said] == (
        [True] if frames < 36 else []
    )


def _stuck(*, after: int, rows: int) -> list[dict[str, str]]:
    """A car that turns in circles where it is after so many rows."""
    driven = trace_rows(TRACK, rows=rows)
    still = driven[after]
    return [
        row if k <= after else row | {name: still[name] for name in ("X", "Y", "progress")}
        for k, row in enumerate(driven)
    ]


@pytest.mark.parametrize(
    ("rows", "stuck_s", "frames"),
    [
        (_stuck(after=15, rows=91), 2, 32),  # it comes no further after 1.07 s
        (_stuck(after=15, rows=91), None, 62),
        (_stuck(after=15, rows=40), 2, 28),
        (trace_rows(TRACK, rows=91), 2, 62),
    ],
)
def test_a_stuck_car_is_not_filmed_to_the_end(
    tmp_path, defaults, monkeypatch, rows, stuck_s, frames
):
    path = tmp_path / "0-iteration.csv"
    path.write_bytes(trace_csv(rows))
    monkeypatch.setattr(WorldView, "frame", lambda *_: np.zeros((480, 640, 3), "u1"))
    options = VideoOptions(fps=10, color="", stuck_seconds=stuck_s)
    trace = trace_of_file(path)

    report = make_video(defaults, no_bucket, trace, options, [("film", tmp_path / "lap.gif")])

    assert report.frames == frames_of(trace, options, [Path(report.file)]) == frames
    assert any("comes no further after" in note for note in report.notes) == (frames == 32)


def test_a_long_film_says_how_long_it_takes(tmp_path, defaults, monkeypatch):
    path = tmp_path / "0-iteration.csv"
    path.write_bytes(trace_csv(trace_rows(TRACK, rows=60)))
    monkeypatch.setattr(WorldView, "frame", lambda *_: np.zeros((480, 640, 3), "u1"))
    clock = itertools.count(0.0, 14.0)  # two readings: a second for each of 14 frames
    monkeypatch.setattr("drcli.view.video.make_video.time.monotonic", lambda: next(clock))
    told = []

    make_video(
        defaults,
        no_bucket,
        trace_of_file(path),
        VideoOptions(fps=10, color=""),
        [("film", tmp_path / "lap.gif")],
        on_progress=told.append,
    )

    assert told == ["The film is done in about 26 s."]


def test_an_explanation_needs_a_policy(bucket, defaults, tmp_path):
    trace = trace_of_evaluation(ModelStore(bucket, "m"), None)

    with pytest.raises(SettingsError, match="No policy is known"):
        make_video(
            defaults,
            lambda: bucket,
            trace,
            VideoOptions(explain=True),
            [("film", tmp_path / "a.gif")],
            policy=PolicyOptions("none"),
        )


@pytest.mark.parametrize("stamp", ["20260102030405", ""])
def test_the_last_key_of_an_evaluations_videos_is_the_one_with_everything(bucket, tmp_path, stamp):
    files = {view: tmp_path / f"{view}.mp4" for view in CAMERAS}
    for view, path in files.items():
        path.write_text(view)

    put = put_videos(ModelStore(bucket, "m"), stamp, files)

    assert len(put) == 3 + bool(stamp)
    assert bucket.get(put[-1]) == b"film"
    assert bucket.get("m/mp4/camera-topview/0-video.mp4") == b"top"


def no_bucket():
    pytest.fail("a file needs no bucket")


def chromium() -> str | None:
    found = shutil.which("chromium-headless-shell") or shutil.which("chromium")
    likely = Path("/usr/lib/chromium/chromium-headless-shell")
    return found or (str(likely) if likely.exists() else None)


def test_a_browser_plays_the_video_with_its_length_and_size(tmp_path):
    pytest.importorskip("av", reason="the extra video is not installed")
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = chromium()
    if program is None:
        pytest.skip("no Chromium is installed")
    from drcli.view.video import encode

    with encode.mp4(tmp_path / "lap.mp4", (480, 640), 15) as writer:
        for k in range(30):
            writer.add(np.full((480, 640, 3), 8 * k, np.uint8))
    page_file = tmp_path / "page.html"
    page_file.write_text("<video id=v muted src=lap.mp4></video>")
    with sync_api.sync_playwright() as play:
        flags = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
        browser = play.chromium.launch(executable_path=program, args=flags)
        page = browser.new_page()
        page.goto(page_file.as_uri())
        shown = page.evaluate(
            """async () => { const v = document.getElementById('v');
            await new Promise(r => v.readyState >= 2 ? r() : v.addEventListener('loadeddata', r));
            await v.play();
            await new Promise(r => v.addEventListener('timeupdate', r));
            return [v.duration, v.videoWidth, v.videoHeight, v.currentTime, v.error]; }"""
        )
        browser.close()
    assert shown[:3] == [pytest.approx(2.0, abs=0.02), 640, 480]
    assert shown[3] > 0
    assert shown[4] is None
