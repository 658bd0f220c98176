"""`dr video` as its caller meets it."""

import signal

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
