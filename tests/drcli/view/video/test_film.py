"""Films: one frame for each moment, and everybody where the trace says."""

import numpy as np
import pytest

from drcli.view.video.film import SIZES, Film, Insight, Scene
from drcli.view.video.overlay import Overlay, Readings, Titles, clock
from drcli.view.video.recorded_lap import read_laps
from drsim.race.solids import SHAPES
from drsim.track.worlds import load_track
from recorded_drives import trace_csv, trace_rows

TRACK = load_track("reinvent_base")
TITLES = Titles("Ada", "model · checkpoint 3", "reinvent_base")
RED = (224.0, 26.0, 37.0)


class Recorder:
    """A renderer that notes what it is shown."""

    size = (48, 64)

    def __init__(self):
        self.seen = []

    def frame(self, lens, things):
        self.seen.append((lens, list(things)))
        return np.full((*self.size, 3), 90, np.uint8)

    def close(self):
        pass


def lap_of(**changes):
    [lap], _ = read_laps(trace_csv(trace_rows(TRACK, **changes)), "lap.csv")
    return lap


def filmed(scene, fps=15, views=("film",)):
    recorder = Recorder()
    frames = list(Film(TRACK, recorder, fps).frames(scene, views))
    return recorder.seen, frames


@pytest.mark.parametrize(("fps", "count"), [(15, 32), (30, 63), (10, 22)])
def test_a_film_shows_a_lap_from_its_beginning_to_its_last_row(fps, count):
    seen, frames = filmed(Scene(lap_of(), TITLES, RED), fps)

    assert len(seen) == len(frames) == count


def test_between_two_rows_the_car_moves_evenly():
    seen, _ = filmed(Scene(lap_of(), TITLES, RED), fps=60)

    places = np.array([things[0].pose[:2] for _, things in seen])
    steps = np.hypot(*np.diff(places, axis=0).T)
    assert steps[:4] == pytest.approx(0.0)  # the `prepare` step
    assert steps[4:] == pytest.approx(1.5 / 60, rel=0.03)
    assert seen[54][1][0].rolled_m == pytest.approx(1.5 * 50 / 60, rel=0.03)


def test_a_car_that_is_put_back_does_not_fly_there():
    rows = trace_rows(TRACK)
    for row in rows[15:]:
        row["X"] = str(float(row["X"]) + 3.0)
    [lap], _ = read_laps(trace_csv(rows), "lap.csv")

    seen, _ = filmed(Scene(lap, TITLES, RED), fps=60)

    across = np.array([things[0].pose[0] for _, things in seen])
    assert np.abs(np.diff(across)).max() > 2.8
    assert max(np.sort(np.abs(np.diff(across)))[:-1]) < 0.1


def test_the_clock_of_the_last_frame_is_the_lap_time_of_the_metrics(monkeypatch):
    shown = []
    monkeypatch.setattr(
        Overlay, "draw", lambda self, frame, now, track_map: shown.append(now) or frame
    )

    filmed(Scene(lap_of(), TITLES, RED), fps=24)

    assert (shown[0].time_s, shown[-1].time_s) == pytest.approx((0.0, 31.0 / 15.0))
    assert shown[-1].progress == pytest.approx(100.0 * 3.0 / TRACK.length_m)


def test_ghosts_drive_along_until_their_lap_ends():
    ghost = lap_of(rows=16, speed_mps=1.0)
    seen, _ = filmed(Scene(lap_of(), TITLES, RED, ghosts=((ghost, (1, 2, 3)),)))

    shown = [[thing for thing in things if thing.ghost] for _, things in seen]
    assert [len(ghosts) for ghosts in shown] == [1] * 17 + [0] * 15
    assert shown[4][0].pose == pytest.approx(ghost.poses[3])
    assert shown[4][0].color == (1.0, 2.0, 3.0)


def test_objects_stand_and_drive_where_they_were():
    lap = lap_of()
    poses = np.tile([[[1.0, 2.0, 0.5], [0.0, 0.0, 0.0]]], (31, 1, 1))
    poses[:, 1, 0] = np.arange(31) * 0.03
    shapes = (SHAPES["box_obstacle"], SHAPES["bot_car"])
    from dataclasses import replace

    seen, _ = filmed(Scene(replace(lap, objects=poses), TITLES, RED, shapes), fps=30)

    for number in (0, 7, 20):
        _, box, bot = seen[number + 2][1]
        assert box.pose == (1.0, 2.0, 0.5)
        assert bot.pose[0] == pytest.approx(0.015 * number)
        assert (box.shape.name, bot.shape.name) == ("box_obstacle", "bot_car")


def test_three_views_of_one_lap_are_made_together():
    seen, frames = filmed(Scene(lap_of(), TITLES, RED), views=("film", "chase", "top"))

    assert len(seen) == 64  # the film is the view from behind, with everything over it
    film, chase, top = frames[0]
    assert (chase == 90).all()
    assert (top == 90).all()
    assert (film != 90).any()


def readings(**changes):
    values = {
        "time_s": 61.5,
        "speed_mps": 1.5,
        "steering_deg": -12.0,
        "progress": 50.0,
        "reward": 12.0,
        "step_reward": 0.5,
        "resets": 0,
        "status": "",
        "good": False,
        "camera": None,
        "probabilities": None,
        "asked": (0.0, 1.0),
        "spread": None,
        "value": None,
        "fastest_mps": 2.0,
    }
    return Readings(**{**values, **changes})


def drawn(size="640x480", titles=TITLES, **changes):
    rows, columns = SIZES[size]
    frame = np.full((rows, columns, 3), 120, np.uint8)
    return Overlay((rows, columns), titles).draw(frame, readings(**changes), None)


@pytest.mark.parametrize("size", SIZES)
def test_the_cameras_picture_stands_at_the_top_right(size):
    camera = np.full((120, 160), 33, np.uint8)

    frame = drawn(size, camera=camera)

    rows, columns = SIZES[size]
    shown = (frame == 33).all(axis=2)
    assert shown.sum() == pytest.approx(160 * 120 * (rows / 480) ** 2, rel=0.02)
    assert np.nonzero(shown)[1].min() > columns / 2
    assert np.nonzero(shown)[0].max() < rows / 2


def test_the_likeliest_action_has_the_highest_bar_and_left_is_left():
    actions = ((-30.0, 1.0), (0.0, 1.0), (30.0, 1.0))
    titles = Titles("Ada", "model", "track", actions)

    def accent(chances):
        frame = drawn(titles=titles, probabilities=np.array(chances))[:200, 320:]
        return np.nonzero((frame == (255, 172, 40)).all(axis=2))[1].mean()

    assert accent([0.1, 0.1, 0.8]) < accent([0.1, 0.8, 0.1]) < accent([0.8, 0.1, 0.1])


def test_progress_fills_the_lower_edge():
    edge = drawn(progress=25.0)[-2]

    filled = (edge == (255, 172, 40)).all(axis=1)
    assert filled.sum() == pytest.approx(160, abs=2)


@pytest.mark.parametrize("name", ["", "A" * 300, "<b>Ω</b>\n{x}", "车手"])
def test_any_name_of_a_racer_fits(name):
    frame = drawn(titles=Titles(name, "m" * 200, "t" * 200, (), (("g" * 99, (1, 2, 3)),) * 4))

    assert (frame[30, 340:] == 120).all()


def test_strange_numbers_are_drawn():
    drawn(time_s=1e6, speed_mps=1e9, steering_deg=-999.0, progress=-5.0, reward=-1e300)
    drawn(probabilities=np.full(60, 1 / 60), camera=np.zeros((120, 160, 3), np.uint8), status="Off")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0, "0:00.000"),
        (16.0664, "0:16.066"),
        (75.5, "1:15.500"),
        (59.9999, "1:00.000"),
        (3723.5, "1:02:03.5"),
    ],
)
def test_a_clock(seconds, text):
    assert clock(seconds) == text


def test_the_range_of_continuous_actions_is_drawn():
    lap = lap_of()
    two = np.tile([[5.0, 1.0]], (31, 1))
    insight = Insight(None, two, 0.8 * two, 1.2 * two, None)

    _, frames = filmed(Scene(lap, TITLES, RED, insight=insight))
    _, without = filmed(Scene(lap, TITLES, RED))

    assert (frames[0][0] != without[0][0]).any()
