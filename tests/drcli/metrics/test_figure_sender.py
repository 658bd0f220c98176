"""The background thread: whatever a sink does, nobody waits and nothing fails."""

import logging
import threading

import pytest

from drcli.base.errors import NotAvailable
from drcli.config.loading import load_settings
from drcli.metrics import open_sinks
from drcli.metrics.figure_events import Ended, EpochPoint, Point
from drcli.metrics.open_sinks import FigureSender

POINT = Point(1, 2.0, {"losses/entropy": 1.0})


class Kept:
    """A sink that keeps what it gets, after it has failed so many times."""

    name, takes = "a tool", (Point,)

    def __init__(self, failures=0, error="the host is away"):
        self.got, self.failures, self.error = [], failures, error
        self.closed = False

    def send(self, event):
        if self.failures:
            self.failures -= 1
            raise OSError(self.error)
        self.got.append(event)

    def miss(self, _):
        return False

    def close(self):
        self.closed = True


@pytest.fixture
def log():
    """What is told in the log."""
    told = []

    class Handler(logging.Handler):
        def emit(self, record):
            if "processor time" not in record.getMessage():
                told.append(record.getMessage())

    handler = Handler(logging.INFO)
    logger = open_sinks._logger
    logger.addHandler(handler)
    yield lambda: told
    logger.removeHandler(handler)


def test_events_arrive_in_order_and_the_end_waits_for_them():
    sink = Kept()
    sender = FigureSender([lambda: sink])
    events = [Point(step, 0.0, {}) for step in range(500)]

    sender.send(*events)
    sender.close()

    assert sink.got == events
    assert sink.closed
    sender.send(POINT)  # after the end, nothing happens
    assert sink.got == events


def test_without_sinks_there_is_no_thread():
    before = threading.active_count()

    sender = FigureSender([])
    sender.send(POINT)
    sender.close()

    assert threading.active_count() == before


def test_a_tool_that_fails_is_told_once_and_left_alone_for_a_while(log):
    now_s = [0.0]
    sink, other = Kept(failures=2), Kept()

    class Clocked(Kept):
        """Moves the clock on, in the same thread, after each event."""

        def send(self, event):
            now_s[0] += 25.0

    sender = FigureSender([lambda: sink, lambda: other, Clocked], clock=lambda: now_s[0])

    sender.send(*[Point(step, 0.0, {}) for step in range(8)])
    sender.close()

    # It fails at 0 s, is tried again after a minute (75 s), fails again, and works at 150 s.
    assert [event.step for event in sink.got] == [6, 7]
    assert len(other.got) == 8
    assert log() == [
        "Live figures: a tool: the host is away. The training goes on; it is tried again.",
        "Live figures: a tool takes them again; 6 were lost.",
    ]


def test_events_that_a_tool_does_not_take_say_nothing_about_it(log):
    now_s = [0.0]
    sink = Kept(failures=2)

    class Clocked(Kept):
        takes = (Point, EpochPoint)

        def send(self, event):
            now_s[0] += 40.0

    sender = FigureSender([lambda: sink, Clocked], clock=lambda: now_s[0])

    sender.send(POINT, *[EpochPoint(0.0, 1.0)] * 3, POINT, *[EpochPoint(0.0, 1.0)] * 3, POINT)
    sender.close()

    assert sink.got == [POINT]
    assert log() == [
        "Live figures: a tool: the host is away. The training goes on; it is tried again.",
        "Live figures: a tool takes them again; 2 were lost.",
    ]


def test_a_tool_that_cannot_be_opened_is_tried_again_and_leaves_the_others_alone(log):
    now_s, sink = [0.0], Kept()
    errors = [OSError("the port is taken"), OSError("the port is taken")]

    def taken():
        if errors:
            raise errors.pop()
        return sink

    class Clocked(Kept):
        takes = (Point, EpochPoint)

        def send(self, event):
            super().send(event)
            now_s[0] += 31.0

    other = Clocked()
    sender = FigureSender([taken, lambda: other], clock=lambda: now_s[0])
    sender.send(*[POINT] * 3, EpochPoint(0.0, 1.0), POINT, POINT)
    sender.close()

    assert len(other.got) == 6
    # It is tried at 0 s and 62 s without success, and at 124 s with it.
    assert sink.got == [POINT] * 2
    assert log() == [
        "Live figures: the port is taken. The training goes on; it is tried again.",
        "Live figures: a tool takes them again; 3 were lost.",
    ]


def test_a_tool_that_is_away_at_the_end_lacks_the_newest_figures(log):
    class Away(Kept):
        def close(self):
            raise OSError("the host is away")

    sender = FigureSender([Away])
    sender.send(POINT)
    sender.close()

    assert log() == [
        "Live figures: a tool: the host is away. The training goes on; it is tried again.",
        "Live figures: a tool lacks the newest of them at the end.",
    ]


def test_a_package_that_is_missing_is_not_looked_for_again(log):
    tries = []

    def broken():
        tries.append(1)
        raise ImportError("No module named 'tensorboard'")

    now_s = iter(range(0, 10**6, 100))
    sender = FigureSender([broken], clock=lambda: next(now_s))
    sender.send(*[POINT] * 4)
    sender.close()

    assert len(tries) == 1
    assert log() == [
        "Live figures: No module named 'tensorboard'. The training goes on without it."
    ]


def test_an_outage_warns_once_and_mentions_another_cause(log):
    class Flapping(Kept):
        def send(self, event):
            self.error = f"cause {self.failures % 2}"
            super().send(event)

    now_s = iter(range(0, 10**6, 100))
    sink = Flapping(failures=5)
    sender = FigureSender([lambda: sink], clock=lambda: next(now_s))
    sender.send(*[POINT] * 6)
    sender.close()

    assert log() == [
        "Live figures: a tool: cause 1. The training goes on; it is tried again.",
        "Live figures: a tool: cause 0.",
        "Live figures: a tool takes them again; 5 were lost.",
    ]


def test_the_end_of_an_outage_is_logged_when_a_tool_is_closed(log):
    class Late(Kept):
        """Keeps what it cannot send, and sends it at the end."""

        def miss(self, event):
            self.got.append(event)
            return True

    sink = Late(failures=1)
    sender = FigureSender([lambda: sink])
    sender.send(POINT, POINT)
    sender.close()

    assert log()[1:] == ["Live figures: a tool has been closed; 0 were lost."]


def test_a_tool_that_hangs_holds_up_nobody(log, monkeypatch):
    monkeypatch.setattr(open_sinks, "MOST_WAITING", 2)
    released = threading.Event()

    class Hanging(Kept):
        def send(self, event):
            released.wait(30.0)

    sender = FigureSender([Hanging])
    try:
        sender.send(*[POINT] * 50)
        sender.close(patience_s=0.05)
    finally:
        released.set()

    assert log()[0] == "Live figures: 2 of them wait to be sent; newer ones are left out."


def settings(folder, *lines):
    (folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=m\n")
    (folder / "system.env").write_text("\n".join(lines) + "\n")
    return load_settings(folder)


def test_the_settings_open_what_they_name_and_nothing_else(tmp_path):
    (tmp_path / "prom").mkdir()
    figures = settings(tmp_path, "DR_PROMETHEUS_FOLDER=prom").run.figures
    facts = open_sinks.TrainingFacts("m", 0)

    sender = open_sinks.sender_of_trainer(figures, tmp_path, facts)
    sender.send(POINT, Ended(3.0, finished=True))
    sender.close()

    assert [path.name for path in (tmp_path / "prom").iterdir()] == ["deepracer-m.prom"]
    assert not open_sinks.sender_of_episodes(figures, "m")._openers
    nothing = settings(tmp_path).run.figures
    assert not open_sinks.sender_of_trainer(nothing, tmp_path, facts)._openers


def test_a_missing_extra_is_named_before_a_start(tmp_path, monkeypatch):
    figures = settings(tmp_path, "DR_TENSORBOARD=True").run.figures
    monkeypatch.setattr(open_sinks.importlib.util, "find_spec", lambda name: None)

    with pytest.raises(NotAvailable, match="tensorboard") as error:
        open_sinks.check_figures(figures)

    assert "drcli[tensorboard]" in error.value.remedy
    open_sinks.check_figures(settings(tmp_path).run.figures)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("DR_TELEGRAF_HOST=http://telegraf", "is not the name or address of a host"),
        ("DR_TELEGRAF_HOST=telegraf:8092", "is not the name or address of a host"),
        ("DR_MLFLOW_URL=mlflow:5000", "is not a web address"),
        ("DR_MLFLOW_URL=https://me:secret@mlflow", "contains a user or password"),
        ("DR_PROMETHEUS_PORT=70000", "from 0 to 65535"),
    ],
)
def test_what_cannot_be_an_address_is_told(tmp_path, line, words):
    with pytest.raises(Exception, match=line.partition("=")[0]) as error:
        settings(tmp_path, line)

    assert words in f"{error.value} {getattr(error.value, 'remedy', '')}"
    assert "secret" not in str(error.value)


def test_an_empty_address_does_not_let_everybody_read_the_figures(tmp_path):
    assert settings(tmp_path, "DR_PROMETHEUS_HOST=").run.figures.prometheus_host == "127.0.0.1"


@pytest.mark.parametrize("host", ["telegraf", "192.168.1.5", "::1", "my_host.lan", ""])
def test_hosts_are_names_and_addresses(tmp_path, host):
    assert settings(tmp_path, f"DR_TELEGRAF_HOST={host}").run.figures.telegraf_host == host
