"""The present warnings of all watches: log, journal, `dr-status`."""

from pathlib import Path

from drcli.base.log import get_logger
from drcli.records.heartbeat import WatchRecord
from drcli.records.run_record import Kind
from drcli.run.journal import Journal

_logger = get_logger(__name__)


class WarningsBoard:
    """Only the supervisor's loop uses it."""

    def __init__(self, folder: Path, session: str, journal: Journal) -> None:
        self._folder = folder
        self._session = session
        self._journal = journal
        self._warnings: dict[str, str] = {}

    def tell(self, kind: Kind, text: str, **facts: object) -> None:
        _logger.warning("%s", text)
        self._journal.note(kind, text, **facts)

    def warn(self, subject: str, text: str, kind: Kind = "notice", **facts: object) -> None:
        self.tell(kind, text, **facts)
        self.show(subject, text)

    def show(self, subject: str, text: str) -> None:
        if self._warnings.get(subject) != text:
            self._warnings[subject] = text
            self._write()

    def clear(self, subject: str) -> None:
        if self._warnings.pop(subject, None) is not None:
            self._write()

    def _write(self) -> None:
        try:
            WatchRecord(self._session, list(self._warnings.values())).write(self._folder)
        except OSError as error:  # a full disk: the log has it
            _logger.warning("The warnings cannot be written for dr-status: %s", error)
