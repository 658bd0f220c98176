"""A run for the watches of a supervisor: workers that are made up, on a clock that a test turns."""

import os
import signal
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drcli.config.loading import load_settings
from drcli.records.heartbeat import HeartbeatRecord, WatchRecord, open_heartbeat_file
from drcli.records.job import Job
from drcli.run.duty import RunningTraining
from drcli.run.journal import Journal
from drcli.run.warnings_board import WarningsBoard
from drcli.run.worker_processes import Child
from memory_bucket import MemoryBucket


class MadeUpProcess:
    """Stands in for `subprocess.Popen`: it lives until it is killed."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self.killed = False
        self.stubborn = False

    def poll(self) -> int | None:
        """The exit code, None while it lives."""
        return self.returncode

    def kill(self) -> None:
        """End it, unless it is `stubborn`."""
        self.killed = True
        if not self.stubborn:
            self.returncode = -signal.SIGKILL


@dataclass
class MadeUpWorker:
    """What a worker writes into its heartbeat."""

    heartbeat: HeartbeatRecord
    beats: bool = True


class WatchedRun:
    """A trainer and some simulation workers, and the clock of their supervisor."""

    def __init__(self, folder: Path, workers: int = 1, **settings: Any) -> None:
        (folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model\n")
        lines = [f"{name}={value}" for name, value in settings.items()]
        (folder / "system.env").write_text("\n".join([f"DR_WORKERS={workers}", *lines, ""]))
        config = load_settings(folder, environ={}).run
        self.folder = folder
        self.now_s = 0.0
        self.job = Job(config, "start", 1, None, folder, os.getpid())
        names = ["trainer", *(f"sim-{k}" for k in range(workers))]
        self.children = [
            Child(name, "module", [name.removeprefix("sim-")] if name != "trainer" else [])
            for name in names
        ]
        self.workers: dict[str, MadeUpWorker] = {}
        self._next_pid = 10_000_000  # no process has such a number
        self.journal = Journal("model", 1, "start")
        bucket = MemoryBucket()
        board = WarningsBoard(folder, "start", self.journal)
        self.running = RunningTraining(
            self.job, bucket, lambda: bucket, self.children, self.journal, board
        )
        for child in self.children:
            self.begin(child.name)

    def clock(self) -> float:
        """The supervisor's clock."""
        return self.now_s

    def child(self, name: str) -> Child:
        """A worker's process as its supervisor sees it."""
        return next(child for child in self.children if child.name == name)

    def begin(self, name: str) -> MadeUpProcess:
        """Start a process of a worker."""
        self._next_pid += 1
        process = MadeUpProcess(self._next_pid)
        child: Any = self.child(name)
        child.process, child.ended_by = process, ""
        heartbeat = HeartbeatRecord(self._next_pid, 0, 0.0, "starting", False, 0, None, 0.0)
        self.workers[name] = MadeUpWorker(heartbeat)
        return process

    def say(self, name: str, activity: str, *, waits: bool = False) -> None:
        """Change what a worker says that it does."""
        worker = self.workers[name]
        worker.heartbeat = replace(worker.heartbeat, activity=activity, waits=waits)

    def write_pulses(self, working: Sequence[str] = (), turning: Sequence[str] = ()) -> None:
        """Let every worker write its heartbeat; some of them have worked, or only turned."""
        for name, worker in self.workers.items():
            if not worker.beats:
                continue
            heartbeat = replace(
                worker.heartbeat, beats=worker.heartbeat.beats + 1, written_s=self.now_s
            )
            if name in working:
                heartbeat = replace(
                    heartbeat, work=heartbeat.work + 1, worked_s=self.now_s, turned_s=self.now_s
                )
            if name in turning:
                heartbeat = replace(heartbeat, turned_s=self.now_s)
            worker.heartbeat = heartbeat
            descriptor = open_heartbeat_file(self.folder, name)
            os.pwrite(descriptor, heartbeat.file_content(), 0)
            os.close(descriptor)

    @property
    def warnings(self) -> list[str]:
        """What `dr-status` shows."""
        return WatchRecord.of_session(self.folder, "start").warnings

    @property
    def told(self) -> list[str]:
        """The sentences in the journal."""
        return [entry.text for entry in self.journal._entries]
