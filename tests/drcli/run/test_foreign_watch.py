"""Other programs whose machine goes away."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from drcli.base.errors import Absent, SettingsError
from drcli.cli.commands.spot_watch import ForeignWatch, NoticeHandling, signal_named
from drcli.clouds.cloud import Notice
from drcli.outside.notices.notice_watch import NoticeWatch


class Source:
    """Announces what a test has laid down."""

    name = "a cloud"

    def __init__(self) -> None:
        self.notices: list[Notice] = []

    def ask(self) -> list[Notice]:
        return self.notices


@pytest.fixture
def source():
    return Source()


@pytest.fixture
def watching(source, tmp_path):
    def make(**handling) -> ForeignWatch:
        watch = NoticeWatch(source, (), tmp_path, poll_s=0.01)
        return ForeignWatch(watch, NoticeHandling(**handling))

    return make


def goes(left_s=120.0, kind="interruption"):
    return Notice("aws", kind, "terminate", left_s, "It goes.")


def python(code):
    return [sys.executable, "-S", "-c", code]


def waits(path, signals="SIGTERM"):
    """A program that writes the signal that it gets."""
    return python(
        "import signal, sys, time\n"
        "def note(number, _):\n"
        f"    open({str(path)!r}, 'w').write(signal.Signals(number).name)\n"
        "    sys.exit(3)\n"
        f"signal.signal(signal.{signals}, note)\n"
        f"open({str(path)!r} + '.ready', 'w').close()\n"
        "time.sleep(60)"
    )


def announce_when_ready(source, path, *notices):
    def wait() -> None:
        deadline = time.monotonic() + 20.0
        while not path.with_name(f"{path.name}.ready").exists():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        source.notices = list(notices)

    threading.Thread(target=wait).start()


@pytest.mark.parametrize(("code", "shown"), [("pass", 0), ("raise SystemExit(9)", 9)])
def test_a_program_that_ends_keeps_its_exit_code(watching, code, shown):
    assert watching().run(python(code)).exit_code == shown


def test_a_program_that_a_signal_ended_has_the_exit_code_of_a_shell(watching):
    report = watching().run(python("import os; os.kill(os.getpid(), 9)"))

    assert report.exit_code == 137


def test_a_program_that_does_not_exist(watching, tmp_path):
    assert watching().run([str(tmp_path / "nothing")]).exit_code == 127
    assert watching().run([str(tmp_path)]).exit_code == 126


def test_on_notice_the_program_gets_the_signal_and_time_and_the_code_is_75(
    watching, source, tmp_path
):
    path = tmp_path / "got"
    told = tmp_path / "told"
    announce_when_ready(source, path, goes())
    on_notice = python(
        "import os, time; time.sleep(0.1); "
        f"open({str(told)!r}, 'w').write(os.environ['DR_NOTICE_SECONDS_LEFT'])"
    )

    report = watching(on_notice=tuple(on_notice)).run(waits(path))

    assert report.exit_code == 75
    assert (report.source, report.kind, report.action) == ("aws", "interruption", "terminate")
    assert path.read_text() == "SIGTERM"
    assert float(told.read_text()) == pytest.approx(120, abs=5)


def test_another_signal_can_be_chosen(watching, source, tmp_path):
    path = tmp_path / "got"
    announce_when_ready(source, path, goes())

    watching(number=signal.SIGUSR1).run(waits(path, "SIGUSR1"))

    assert path.read_text() == "SIGUSR1"


def test_a_program_that_does_not_exit_in_its_time_is_killed(watching, source, tmp_path):
    path = tmp_path / "got"
    stubborn = python(
        "import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        f"open({str(path)!r} + '.ready', 'w').close()\ntime.sleep(60)"
    )
    announce_when_ready(source, path, goes())
    began_s = time.monotonic()

    assert watching(wait_s=0.3).run(stubborn).exit_code == 75
    assert time.monotonic() - began_s < 15.0


def test_sigterm_for_the_watch_is_a_notice(watching, tmp_path):
    path = tmp_path / "got"

    class Scheduler:
        name = "a scheduler"

        def ask(self):
            if path.with_name("got.ready").exists():
                os.kill(os.getpid(), signal.SIGTERM)
            return []

    watch = NoticeWatch(Scheduler(), (), tmp_path, poll_s=0.05)

    report = ForeignWatch(watch, NoticeHandling()).run(waits(path))

    assert (report.exit_code, report.source) == (75, "signal")
    assert path.read_text() == "SIGTERM"


def test_a_recommendation_counts_where_it_is_asked_for(watching, source):
    source.notices = [goes(None, "rebalance")]

    assert watching(on_rebalance=True).wait().kind == "rebalance"


def test_a_process_that_runs_already_gets_the_signal(watching, source, tmp_path):
    path = tmp_path / "got"
    announce_when_ready(source, path, goes())
    with subprocess.Popen(waits(path)) as process:
        # Nobody else fetches the exit code of this child, so a thread does.
        threading.Thread(target=process.wait).start()
        report = watching().follow(process.pid)

    assert report.exit_code == 75
    assert path.read_text() == "SIGTERM"


def test_a_process_that_does_not_run(watching):
    with pytest.raises(Absent, match="No process 2000000000"):
        watching().follow(2_000_000_000)


def test_without_a_program_the_notice_is_waited_for(watching, source):
    source.notices = [goes(30.0)]

    report = watching().wait()

    assert (report.exit_code, report.text) == (0, "It goes.")


def test_once_tells_by_its_exit_code(watching, source):
    assert watching().once().exit_code == 1

    source.notices = [goes()]

    assert watching().once().exit_code == 0


@pytest.mark.parametrize("text", ["USR1", "sigusr1", str(int(signal.SIGUSR1))])
def test_signals_by_name_and_number(text):
    assert signal_named(text) is signal.SIGUSR1


@pytest.mark.parametrize("text", ["", "NOPE", "99999", "-1"])
def test_what_is_no_signal_is_refused(text):
    with pytest.raises(SettingsError, match="is not a signal"):
        signal_named(text)
