"""Sends logs of trainings and evaluations to CloudWatch; failures end neither."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from drcli.base import notices
from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.base.termination import Stopped
from drcli.exchange.job import Job
from drcli.runs.duty import Duty, RunningTraining
from drcli.runs.journal import Journal
from drcli.runs.log_sender import LogSender, LogService
from drcli.runs.outcome import Ending
from drcli.runs.warnings_board import WarningsBoard

_logger = get_logger(__name__)

END_PATIENCE_S = 6.0
STOPPED_PATIENCE_S = 1.0


class CloudWatchLogs(Duty):
    name = "CloudWatch"

    def __init__(
        self,
        job: Job,
        board: WarningsBoard,
        *,
        connect: Callable[[], LogService] | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._job = job
        self._board = board
        self._connect = connect
        self._clock = clock
        self._journal: Journal | None = None
        self._sender: LogSender | None = None

    def start(self, run: RunningTraining) -> None:
        settings = self._job.config.logs
        if not settings.cloud_watch_enable:
            return
        self._journal = run.journal
        self._sender = LogSender(
            self._job,
            ["supervisor", *(child.name for child in run.children)],
            connect=self._connect,
            clock=self._clock,
            on_failure=self._failed,
        )
        group, first = settings.cloud_watch_log_group, self._sender.first_stream
        _logger.info("The logs are sent to CloudWatch: group %s, streams %s, ...", group, first)
        self._sender.start()

    def check(self) -> None:
        failure = self._sender and self._sender.failure  # the thread may change it meanwhile
        if failure:
            self._board.show(self.name, failure)
        else:
            self._board.clear(self.name)

    def leave(self, ending: Ending) -> None:
        if self._sender is None:
            return
        self._sender.finish(min(END_PATIENCE_S, ending.left_s(0.8)), ending.hurried)
        if left := self._sender.left_bytes:
            _logger.warning("%s A start with --resume sends them.", _not_sent(left))

    def _failed(self, error: DrError) -> None:
        _logger.warning("%s %s", error, error.remedy)
        if self._journal is not None:
            self._journal.note("fault", str(error))


@contextmanager
def sent_to_cloud_watch(
    job: Job, names: Sequence[str], *, connect: Callable[[], LogService] | None = None
) -> Iterator[None]:
    """Send the logs of an evaluation, just begun anew, during the `with` block."""
    if not job.config.logs.cloud_watch_enable:
        yield
        return
    sender = LogSender(job, names, connect=connect)
    sender.start()
    patience_s = STOPPED_PATIENCE_S
    try:
        yield
        patience_s = END_PATIENCE_S
    except DrError as error:
        patience_s = STOPPED_PATIENCE_S if isinstance(error, Stopped) else END_PATIENCE_S
        raise
    finally:
        sender.finish(patience_s)
        if sender.failure:
            notices.warn(sender.failure)
        elif left := sender.left_bytes:
            notices.warn(_not_sent(left))


def _not_sent(left_bytes: int) -> str:
    how_much = f"{left_bytes / 1e6:,.1f} MB" if left_bytes > 100_000 else "The newest lines"
    return f"{how_much} of the logs were not sent to CloudWatch in time."
