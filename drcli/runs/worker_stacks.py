"""Asks a worker where its threads are, and looks whether that is inside the reward function."""

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drcli.exchange.job import Job
from drcli.exchange.log_places import log_file
from drcli.rewards.reward_timeout import source_line, stuck_place
from drcli.runs.worker_processes import Child
from drcli.workers.pulse import STACKS_SIGNAL

ANSWER_S = 4.0
"""How long a worker may take to write its stacks."""

REWARD_REMEDY = (
    "Correct reward_function.py, then continue with `dr-start-training --resume-or-start`."
)
"""What to do when a worker was stuck inside the reward function."""


@dataclass(frozen=True)
class StacksRequest:
    """A request for the stacks of a worker, which it writes into its log.

    Attributes:
        log: Its log.
        begin: Size of the log before the request.
    """

    log: Path
    begin: int

    @staticmethod
    def send(job: Job, child: Child) -> "StacksRequest | None":
        """Ask a worker that has written a pulse; None if it has ended."""
        log = log_file(job.directory, job.config.model.prefix, child.name)
        if child.process is None or not child.running or STACKS_SIGNAL is None:
            return None
        begin = log.stat().st_size if log.exists() else 0
        with suppress(ProcessLookupError):
            os.kill(child.process.pid, STACKS_SIGNAL)
        return StacksRequest(log, begin)

    def reward_place(self) -> tuple[int, str]:
        """Line of the reward function in which the worker is, and its text; 0 if it is not."""
        try:
            with self.log.open("rb") as file:
                # A log that has become shorter is a new one.
                file.seek(self.begin if self.begin <= self.log.stat().st_size else 0)
                text = file.read(1 << 20).decode("utf-8", "replace")
        except OSError:
            return 0, ""
        path, line = stuck_place(text)
        return line, source_line(path, line)
