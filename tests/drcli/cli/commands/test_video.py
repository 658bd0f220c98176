"""`dr video` as its caller meets it."""

import signal

import pytest

from drcli.base.errors import SettingsError
from drcli.view.video import encode
from drsim.track.worlds import load_track
from recorded_drives import trace_csv, trace_rows


def test_a_film_that_sigterm_stops_leaves_no_file(dr, working_folder, monkeypatch, capsys):
    (working_folder / "lap.csv").write_bytes(
        trace_csv(trace_rows(load_track("reinvent_base"), rows=5))
    )
    before = sorted(working_folder.iterdir())
    finished = []

    def stop(_gif, _frame):
        signal.raise_signal(signal.SIGTERM)
        finished.append(True)

    monkeypatch.setattr(encode._Gif, "add", stop)

    code = dr("video", "lap.csv", "--gif")

    assert code == 143
    assert not finished
    assert "The video was stopped" in capsys.readouterr().err
    assert sorted(working_folder.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--episode", "3"), "leave out --episode"),
        (("team/model",), "leave out team/model"),
        (("-o", "knobs.gif"), "does not end in .png"),
    ],
)
def test_a_filmstrip_of_knobs_is_no_film(dr, working_folder, capsys, words, told):
    code = dr("video", "--knobs", *words)

    assert code == 2
    assert told in " ".join(capsys.readouterr().err.split())
    assert not list(working_folder.glob("knobs.*"))


def test_a_filmstrip_of_knobs_replaces_no_file(dr, working_folder, capsys):
    (working_folder / "knobs.png").touch()

    code = dr("video", "--knobs")

    assert code == SettingsError.code
    assert "knobs.png exists already" in capsys.readouterr().err
    assert not (working_folder / "knobs.png").read_bytes()
