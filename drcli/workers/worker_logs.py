"""The logs of a worker: its own, as JSON lines, and what the racer's code prints.

That is in its own log too, where other tools look for it.
"""

import logging
from collections.abc import Callable
from pathlib import Path

from drcli.base.json_log import JsonLog
from drcli.base.log import LogFile, add_handler, record_text, remove_handler
from drcli.base.rotating_file import RotatingFile
from drcli.exchange.job import Job
from drcli.exchange.log_places import json_log, log_file, reward_log
from drcli.workers import print_limit


class WorkerLogs:
    def __init__(self, job: Job, name: str, path: Path | None) -> None:
        settings = job.config.logs
        max_bytes = settings.log_max_mb << 20
        self._json: JsonLog | None = None
        self._prints: _RewardLog | None = None
        copies: list[Callable[[str], None]] = []
        if path is not None:
            LogFile(path, max_bytes)
            prints = log_file(job.directory, job.config.model.prefix, reward_log(name))
            self._prints = _RewardLog(prints, max_bytes)
            copies.append(self._prints.file.write)
            if settings.log_json:
                self._json = JsonLog(json_log(path), max_bytes, name)
                copies.append(self._json.printed)
        print_limit.install(copies)

    def end(self) -> None:
        if self._prints is not None:
            self._prints.end()
        if self._json is not None:
            self._json.end()


class _RewardLog(logging.Handler):
    """Our records between the reward function's prints."""

    def __init__(self, path: Path, max_bytes: int) -> None:
        super().__init__()
        self.file = RotatingFile(path, max_bytes)
        add_handler(self)

    def emit(self, record: logging.LogRecord) -> None:
        if record.name == print_limit.reward_logger.name:
            self.file.write(f"{record_text(record)}\n")

    def end(self) -> None:
        remove_handler(self)
        self.file.close()
