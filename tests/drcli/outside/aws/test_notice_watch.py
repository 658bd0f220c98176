"""What the watch knows without waiting: the service's answers, and the racer's program."""

import logging
import sys
from pathlib import Path

import pytest

from drcli.base.clock import wait_until
from drcli.base.errors import SettingsError
from drcli.clouds.cloud import MetadataSilent, Notice
from drcli.outside.notices import notice_watch
from drcli.outside.notices.notice_watch import (
    Announced,
    NoticeWatch,
    command_words,
    notice_of_command,
    soonest,
)

GOES = Notice("aws", "interruption", "terminate", 120.0, "It goes.")
ADVICE = Notice("aws", "rebalance", "rebalance", None, "Move.")


class Source:
    """Answers what a test has laid down."""

    name = "a cloud"

    def __init__(self, *answers: list[Notice] | Exception) -> None:
        self.answers = list(answers)
        self.times = 0

    def ask(self) -> list[Notice]:
        self.times += 1
        answer = self.answers[min(self.times, len(self.answers)) - 1]
        if isinstance(answer, Exception):
            raise answer
        return answer


@pytest.fixture
def started():
    watches: list[NoticeWatch] = []

    def start(*arguments, **options) -> NoticeWatch:
        watches.append(NoticeWatch(*arguments, poll_s=0.01, pause_s=0.01, **options))
        watches[-1].start()
        return watches[-1]

    yield start
    for watch in watches:
        watch.stop()


def test_a_notice_is_seen(started):
    watch = started(Source([], [GOES]))

    assert wait_until(watch.announced, patience_s=10.0)

    assert [one.notice for one in watch.announced()] == [GOES]


def test_a_notice_that_is_taken_back_is_forgotten(started):
    source = Source([GOES], [])
    watch = started(source)

    assert wait_until(lambda: source.times > 2, patience_s=10.0)

    assert watch.announced() == []


def test_a_silent_service_is_mentioned_once_and_asked_seldom(started, monkeypatch, caplog):
    monkeypatch.setattr(notice_watch, "_logger", logging.getLogger("watch"))
    monkeypatch.setattr(notice_watch, "SILENT_POLL_S", 0.01)
    source = Source(MetadataSilent("It is silent.", remedy=""))
    with caplog.at_level("INFO", "watch"):
        started(source)
        assert wait_until(lambda: source.times > 20, patience_s=10.0)

    assert [record.getMessage() for record in caplog.records] == [
        "No notices from a cloud: It is silent."
    ]


def test_a_fault_of_ours_does_not_end_the_watch(started, monkeypatch):
    monkeypatch.setattr(notice_watch, "SILENT_POLL_S", 0.01)

    watch = started(Source(KeyError("odd"), KeyError("odd"), KeyError("odd"), [GOES]))

    assert wait_until(watch.announced, patience_s=10.0)


def test_time_runs_from_the_moment_of_reading():
    assert Announced(GOES, 100.0).left_s(130.0) == 90.0
    assert Announced(GOES, 100.0).left_s(1000.0) == 0.0
    assert Announced(ADVICE, 100.0).left_s(130.0) is None


def test_the_soonest_interruption_counts_and_a_recommendation_is_none():
    later = Announced(GOES, 50.0)
    sooner = Announced(GOES, 0.0)

    assert soonest([Announced(ADVICE, 0.0), later, sooner], 60.0) == sooner
    assert soonest([Announced(ADVICE, 0.0)], 60.0) is None


def python(code: str) -> list[str]:
    return [sys.executable, "-S", "-c", code]


def test_a_program_that_exits_with_0_is_a_notice(started, tmp_path):
    watch = started(None, python("print('soon'); print(45)"), tmp_path)

    assert wait_until(watch.announced, patience_s=10.0)

    (one,) = watch.announced()
    assert (one.notice.source, one.notice.seconds_left) == ("command", 45.0)


def test_a_program_that_fails_is_started_again(started, tmp_path):
    counted = (
        "from pathlib import Path; p = Path('n'); n = len(p.read_text()) if p.exists() else 0; "
        "p.write_text('x' * (n + 1)); raise SystemExit(0 if n == 2 else 3)"
    )
    watch = started(None, python(counted), tmp_path)

    assert wait_until(watch.announced, patience_s=10.0)

    assert (tmp_path / "n").read_text() == "xxx"


def test_a_program_that_does_not_exist_is_mentioned_once(started, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(notice_watch, "_logger", logging.getLogger("watch"))
    with caplog.at_level("INFO", "watch"):
        watch = started(None, [str(tmp_path / "nothing")], tmp_path)
        assert wait_until(lambda: caplog.records, patience_s=10.0)
        watch.stop()

    assert "DR_INTERRUPTION_COMMAND cannot be started" in caplog.records[0].getMessage()
    assert len(caplog.records) == 1


def test_stopping_ends_the_program(started, tmp_path):
    code = "import os, time; open('pid', 'w').write(str(os.getpid())); time.sleep(60)"
    watch = started(None, python(code), tmp_path)
    path = tmp_path / "pid"
    assert wait_until(lambda: path.exists() and path.read_text(), patience_s=10.0)

    watch.stop()

    pid = int(path.read_text())
    assert wait_until(lambda: not Path(f"/proc/{pid}").exists(), patience_s=10.0)
    assert watch.announced() == []


def test_a_program_gets_no_secrets(started, tmp_path, monkeypatch):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "canary")
    code = "import os; open('env', 'w').write(repr(dict(os.environ)))"
    watch = started(None, python(code), tmp_path)

    assert wait_until(watch.announced, patience_s=10.0)

    assert "canary" not in (tmp_path / "env").read_text()


@pytest.mark.parametrize(
    ("output", "left_s"),
    [
        (b"", None),
        (b"120\n\n", 120.0),
        (b"x\n", None),
        (b"-5", None),
        (b"nan", None),
        (b"\xff", None),
    ],
)
def test_the_last_line_may_be_the_seconds_that_are_left(output, left_s):
    assert notice_of_command(output).seconds_left == left_s


def test_a_command_line_with_an_open_quotation_is_refused():
    with pytest.raises(SettingsError, match="DR_INTERRUPTION_COMMAND=sh -c 'x"):
        command_words("sh -c 'x")
