"""The view from behind a car is prepared where nobody waits for it."""

import threading

from drcli.live import live_server
from drcli.live.live_server import ChaseView
from drsim.track.worlds import load_track
from live_worker import until


def test_the_first_picture_which_compiles_is_made_by_the_painter(monkeypatch):
    made_by = []

    class World:
        def __init__(self, *_, **__) -> None:
            pass

        def frame(self, lens, things):
            made_by.append(threading.current_thread().name)

    monkeypatch.setattr(live_server, "WorldView", World)
    view, track = ChaseView(), load_track("reinvent_base")

    until(lambda: view.is_ready(track))

    assert made_by == ["live-painter"]
    assert not view.hint
