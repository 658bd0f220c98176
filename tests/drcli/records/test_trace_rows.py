"""One drive, written in every way that is known: all readers of traces find the same rows."""

import csv
import io
import json
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from drcli.analysis.model_source import open_model
from drcli.analysis.read_run import run_of
from drcli.base.errors import SettingsError
from drcli.cli.commands.action_space import traces_in_folders
from drcli.config.loading import load_settings
from drcli.records.trace import COLUMNS, read_rows
from drcli.run.seen_in_bucket import lap_lines
from drcli.view.video.trace_source import trace_of_file
from drsim.car.car import REFERENCE_POINT_AHEAD_M
from drsim.fidelity.recordings import RecordingError, load_recordings
from drsim.track.worlds import load_track
from recorded_drives import trace_rows

TRACK = load_track("reinvent_base")
ANGLES = (-20.0, 0.0, 25.0)


def drive() -> list[dict[str, str]]:
    """Two episodes, the second of which ends off the track; actions change from step to step."""
    rows = []
    for episode in range(2):
        driven = trace_rows(TRACK, episode=episode, status="off_track", clock_s=100.0 * episode + 1)
        rows += driven
    for k, row in enumerate(rows):
        row["steer"], row["throttle"] = str(ANGLES[k % 3]), str(1.25 + 0.5 * (k % 2))
        row["action"] = str(k % 6)
        row["all_wheels_on_track"] = str(row["done"] == "False")
    return rows


ROWS = drive()
DRIVEN = [row for row in ROWS if row["episode_status"] != "prepare"]


def with_pair(form: str) -> list[dict[str, str]]:
    """The drive with continuous actions in some form, such as `[{} {}]`."""
    return [row | {"action": form.format(row["steer"], row["throttle"])} for row in ROWS]


def table(rows=ROWS, names=COLUMNS, end="\n") -> bytes:
    """A CSV as it is: an action may have a comma, or quotes."""
    lines = [",".join(row[name] for name in names) for row in rows]
    return end.join([",".join(names), *lines, ""]).encode()


def quoted() -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, quoting=csv.QUOTE_ALL)
    writer.writerows([COLUMNS, *([row[name] for name in COLUMNS] for row in ROWS)])
    return text.getvalue().encode()


FORMATS = (
    *("{:.0f}", "{:.0f}", "{:.4f}", "{:.4f}", "{:.4f}", "{:.2f}", "{:.2f}", "{}", "{:.4f}", "{}"),
    *("{}", "{:.4f}", "{:.0f}", "{:.2f}", "{:.4f}", "{}", "{:.2f}", "{:.0f}", "{:.4f}"),
)


def log(count: int, rows=ROWS, line: str = "SIM_TRACE_LOG:{}", radians: bool = False) -> bytes:
    """The lines of a log with so many fields, between others."""
    lines = [" * /WORLD_NAME: reinvent_base", "Reset agent"]
    for row in rows:
        cells = dict(row)
        for name in ("yaw", "steer") if radians else ():
            cells[name] = str(math.radians(float(row[name])))
        fields = [
            form.format(cells[name] if form == "{}" else float(cells[name]))
            for form, name in zip(FORMATS[:count], COLUMNS, strict=False)
        ]
        lines.append(line.format(",".join(fields)))
    return ("\n".join([*lines, "Training> Name=main_level/agent"]) + "\n").encode()


def of_2019() -> bytes:
    """The step of a reset has the number 0, and the time is that of a wall clock."""
    rows = [row | {"steps": str(float(row["steps"]) - 1)} for row in ROWS]
    rows = [row | {"tstamp": str(1.55e9 + float(row["tstamp"]))} for row in rows]
    return log(15, rows, radians=True)


def of_cloudwatch() -> bytes:
    """All messages in one line, which has no end."""
    return json.dumps([{"message": f"{line}\n"} for line in log(19).decode().splitlines()]).encode()


def of_docker() -> bytes:
    lines = log(19, with_pair('"[{}, {}]"')).decode().splitlines(keepends=True)
    return "".join(json.dumps({"log": line}) + "\n" for line in lines).encode()


WAYS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "of ours": ("0-iteration.csv", lambda: table(names=(*COLUMNS, "reward_ms"))),
    "version 6": ("0-iteration.csv", table),
    "version 4": ("0-iteration.csv", lambda: table(names=COLUMNS[:17])),
    "without a status": ("0-iteration.csv", lambda: table(names=COLUMNS[:15])),
    "continuous": ("0-iteration.csv", lambda: table(with_pair("[{} {}]"))),
    "numpy's blanks": ("0-iteration.csv", lambda: table(with_pair("[ {}   {} ]"))),
    "a bare list": ("0-iteration.csv", lambda: table(with_pair("[{}, {}]"))),
    "a list in quotes": ("0-iteration.csv", lambda: table(with_pair('"[{}, {}]"'))),
    "all in quotes": ("0-iteration.csv", quoted),
    "of Excel": ("0-iteration.csv", lambda: b"\xef\xbb\xbf" + table(end="\r\n")),
    "of a spreadsheet": ("0-iteration.csv", lambda: table().replace(b",", b";")),
    "of a German spreadsheet": (
        "0-iteration.csv",
        lambda: table(with_pair("[{} {}]"), end="\r\n").replace(b",", b";").replace(b".", b","),
    ),
    "with tabs": ("0-iteration.csv", lambda: table().replace(b",", b"\t")),
    "columns in another order": ("0-iteration.csv", lambda: table(names=COLUMNS[::-1])),
    "blanks and small flags": (
        "0-iteration.csv",
        lambda: table().replace(b",", b", ").replace(b"True", b"true").replace(b"False", b"0"),
    ),
    "a log of version 6": ("sim.log", lambda: log(19)),
    "a log of version 5.3": ("sim.log", lambda: log(18)),
    "a log of version 4": ("sim.log", lambda: log(17)),
    "a log of 2020": ("sim.log", lambda: log(16)),
    "a log of 2019": ("sim.log", of_2019),
    "a log with a bare list": ("sim.log", lambda: log(17, with_pair("[{}, {}]"))),
    "a log with a list in quotes": ("sim.log", lambda: log(19, with_pair('"[{}, {}]"'))),
    "a log with blanks": ("sim.log", lambda: log(19, with_pair("[{} {}]"))),
    "a log of ROS 2": ("sim.log", lambda: log(19, line="[launcher] [agent-9] SIM_TRACE_LOG:{}\t")),
    "a log in colours": ("sim.log", lambda: log(19, line="\x1b[32mINFO SIM_TRACE_LOG:{}\x1b[0m")),
    "a log of Docker": (
        "sim.log",
        lambda: log(19, line='{{"log":"SIM_TRACE_LOG:{}\\n","stream":"stdout"}}'),
    ),
    "a log of Docker with a list in quotes": ("sim.log", of_docker),
    "a log of CloudWatch": ("sim.log", of_cloudwatch),
    "a log of PowerShell": ("sim.log", lambda: log(19).decode().encode("utf-16")),
}
"""Names of files and what is in them."""

NO_TRACES = {
    "a picture": b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
    "no names": table().partition(b"\n")[2],
    "names in small letters": table().replace(b"X,Y", b"x,y").replace(b"steer", b"angle"),
    "names alone": table([]),
    "too few fields": table([]) + table(names=COLUMNS[:18]).partition(b"\n")[2],
}


@dataclass
class Found:
    """What a reader knows of the rows, a value for each; None for what it does not read."""

    rows: list[dict[str, str]]
    x: object = None
    y: object = None
    steering: object = None
    speed: object = None
    progress: object = None


@pytest.fixture
def settings(tmp_path):
    (tmp_path / "run.env").write_text("")
    return load_settings(tmp_path, environ={})


def by_analysis(path, settings):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = run_of(open_model(settings, str(path)), settings.tracks_folder, settings.directory)
    steps = run.steps
    assert len(run.episodes) == 2
    assert steps["wall_clock"].isna().all() or (steps["wall_clock"] > 1e9).all()
    columns = (steps[name] for name in ("x", "y", "steering_angle", "speed", "progress"))
    return Found(ROWS, *columns)


def by_action_space(path, _):
    [file] = traces_in_folders([path])
    steering, speed = zip(*(step.pair for step in file.steps), strict=True)
    progress = [step.progress for step in file.steps]
    assert file.skipped == 0
    return Found(DRIVEN, steering=steering, speed=speed, progress=progress)


def by_video(path, _):
    found = trace_of_file(path)
    assert not found.notes
    assert [lap.status[0] for lap in found.laps] == ["prepare"] * 2
    assert [lap.status[-1] for lap in found.laps] == ["off_track"] * 2
    x, y, yaw = np.concatenate([lap.poses for lap in found.laps]).T
    x, y = x + REFERENCE_POINT_AHEAD_M * np.cos(yaw), y + REFERENCE_POINT_AHEAD_M * np.sin(yaw)
    names = ("steering_deg", "speed_mps", "progress")
    rest = (np.concatenate([getattr(lap, name) for lap in found.laps]) for name in names)
    return Found(ROWS, x, y, *rest)


def by_page(path, _):
    lines = lap_lines(path.read_bytes())
    if not lines:
        raise SettingsError("No line.", remedy="None.")
    assert [line.status for line in lines] == ["off_track"] * 2
    return Found(ROWS, [x for line in lines for x in line.x], [y for line in lines for y in line.y])


def by_replay(path, _):
    recordings = load_recordings(path)
    assert recordings.left_out == 0
    drives = recordings.drives
    x, y, _ = np.concatenate([drive.poses for drive in drives]).T
    steering, speed = np.concatenate([drive.actions for drive in drives]).T
    progress = np.concatenate([drive.progress for drive in drives])
    return Found(ROWS, x, y, steering, speed, progress)


READERS = [by_analysis, by_action_space, by_video, by_page, by_replay]
CASES = [
    pytest.param(way, reader, id=f"{way}-{reader.__name__}")
    for way, (name, _) in WAYS.items()
    for reader in READERS
    if reader is not by_replay or name.endswith(".csv")
]
"""`drsim.replay` reads CSV files only."""


@pytest.mark.parametrize(("way", "reader"), CASES)
def test_every_reader_finds_the_same_rows_however_they_were_written(
    tmp_path, settings, way, reader
):
    name, content = WAYS[way]
    path = tmp_path / name
    path.write_bytes(content())

    found = reader(path, settings)

    columns = {"x": "X", "y": "Y", "steering": "steer", "speed": "throttle", "progress": "progress"}
    rounding = {"x": 0.01, "y": 0.01, "steering": 0.5, "speed": 0.01, "progress": 0.01}
    for attribute, column in columns.items():
        values = getattr(found, attribute)
        if values is not None:
            wanted = [float(row[column]) for row in found.rows]
            assert list(values) == pytest.approx(wanted, abs=rounding[attribute]), attribute


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("way", NO_TRACES)
def test_every_reader_refuses_what_is_not_a_trace_by_its_name(tmp_path, settings, way, reader):
    path = tmp_path / "0-iteration.csv"
    path.write_bytes(NO_TRACES[way])

    with pytest.raises((SettingsError, RecordingError)) as refused:
        reader(path, settings)

    assert reader is by_page or "0-iteration.csv" in str(refused.value)


def test_whole_numbers_that_a_file_lacks_have_values_of_their_own():
    [row] = read_rows(b"X,Y\n1.5,2.5\n").rows

    assert (row.x, row.episode, row.closest_waypoint) == (1.5, 0, -1)
