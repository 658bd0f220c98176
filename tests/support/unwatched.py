"""A training that nobody watches, for tests of what its supervisor does besides its workers."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drcli.bucket.bucket import Bucket
from drcli.config.loading import load_settings
from drcli.model.model_store import ModelStore
from drcli.records.job import Job
from drcli.run.checkpoint_watch import CheckpointWatch
from drcli.run.command_process import CommandEnd
from drcli.run.duty import RunningTraining
from drcli.run.journal import Journal
from drcli.run.outcome import Ending, Outcome
from drcli.run.warnings_board import WarningsBoard
from evaluations import evaluated
from memory_bucket import MemoryBucket


def job_of(folder: Path, *lines: str, session: str = "start", term: int = 1) -> Job:
    """The job of a training whose run.env has these lines."""
    written = ["DR_WORLD_NAME=reinvent_base", "DR_LOCAL_S3_MODEL_PREFIX=team/model", *lines]
    (folder / "run.env").write_text("".join(f"{line}\n" for line in written))
    if not (folder / "system.env").exists():
        (folder / "system.env").write_text("DR_UPLOAD_S3_BUCKET=uploads\n")
    return Job(
        config=load_settings(folder, environ={}).run,
        session=session,
        seed=1,
        max_minutes=None,
        folder=folder / "data" / "runs" / "0",
        launcher_pid=os.getpid(),
        term=term,
    )


class Clock:
    """Seconds that pass when a test says so."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


class Watched(CheckpointWatch):
    """Checkpoints that a test sets."""

    def work(self) -> None:
        """See nothing new."""

    def has(self, last: int, best: int | None = None) -> None:
        """Let the training have these checkpoints."""
        from drcli.records.scores import Score

        self.last = Score(f"{last}_Step-{last}00.ckpt")
        if best is not None:
            self.best = Score(f"{best}_Step-{best}00.ckpt", 90.0)


class Command:
    """Stands for a process of one of our commands, which ends when a test says how."""

    def __init__(self, arguments: tuple[str, ...]) -> None:
        self.arguments = arguments
        self.end: CommandEnd | None = None
        self.killed = False
        self.waited_s: float | None = None

    def poll(self) -> CommandEnd | None:
        """How it ended."""
        return self.end

    def wait(self, within_s: float, give_up: Callable[[], bool] = lambda: False) -> CommandEnd:
        """Its end, or that it was killed."""
        self.waited_s = within_s
        return self.end or self.kill()

    def kill(self) -> CommandEnd:
        """Note it."""
        self.killed = True
        return CommandEnd(-9, reason="it was killed because its time was over.", killed=True)


class Commands:
    """Starts no processes, and remembers which were wanted.

    Attributes:
        ends: How the next ones end at once; those after them run on.
    """

    def __init__(self, *ends: CommandEnd) -> None:
        self.started: list[Command] = []
        self.ends = list(ends)

    def __call__(self, job: Job, *arguments: str) -> Any:
        """Start one."""
        command = Command(arguments)
        if self.ends:
            command.end = self.ends.pop(0)
        self.started.append(command)
        return command

    @property
    def names(self) -> list[str]:
        """What was started, in order."""
        return [" ".join(command.arguments[:2]) for command in self.started]


def running(job: Job, bucket: MemoryBucket | None = None) -> RunningTraining:
    """The run as its duties see it."""
    store = bucket or MemoryBucket()
    journal = Journal(job.config.model.prefix, job.term, job.session)
    board = WarningsBoard(job.folder, job.session, journal)
    return RunningTraining(job, store, lambda: store, [], journal, board)


def entries(run: RunningTraining) -> list[tuple[str, str]]:
    """Kind and text of everything in its journal."""
    return [(entry.kind, entry.text) for entry in run.journal._entries]


def ending(code: int = 0, left_s: float | None = None, message: str = "It is over.") -> Ending:
    """The end of a run with so much time left."""
    import time

    deadline_s = None if left_s is None else time.monotonic() + left_s
    return Ending(Outcome(code, message, save_within_s=left_s), deadline_s, lambda: False)


def put_scores(bucket: Bucket, prefix: str, *numbers: int) -> None:
    """Lay down a model whose checkpoints get better."""
    from drcli.model.checkpoints import CheckpointStore

    store = CheckpointStore(ModelStore(bucket, prefix))
    for number in numbers:
        record = store.save(number, 100 * number, b"weights")
        store.record_evaluation(evaluated(record.name, 50.0 + number), "progress")
