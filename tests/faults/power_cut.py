"""Power cuts: a training on a file system of its own, which stops and forgets its memory."""

import os
import random
import shutil
import struct
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from fcntl import ioctl
from pathlib import Path

import psutil

from drcli.base.errors import DrError
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing
from drcli.bucket.connect import FolderBucket
from drcli.bucket.server import server
from drcli.model.checkpoints import CheckpointStore, checkpoint_objects
from drcli.model.history import read_history
from drcli.model.model_prefix import ModelListing
from drcli.model.model_store import ModelStore
from fault_audit import Audit
from fault_machine import PREFIX, Machine, Storage, now_s, works_in

DISK_BYTES = 1 << 30
SHUTDOWN = 0x8004587D
"""EXT4_IOC_SHUTDOWN of linux/fs/ext4/ext4.h."""

WITHOUT_LOG = 2
"""EXT4_GOING_FLAGS_NOLOGFLUSH: what the file system has not given to the disk is lost."""

PATIENCE_S, UNMOUNT_S = 240.0, 20.0
POLL_S = 0.05


def why_not() -> str:
    """Why there can be no such disk here; empty if there can."""
    if os.geteuid() != 0:
        return "only root may mount a file system"
    missing = [name for name in ("losetup", "mkfs.ext4", "mount") if shutil.which(name) is None]
    if missing:
        return f"there is no {missing[0]}"
    free = subprocess.run(["losetup", "--find"], capture_output=True, text=True)
    return free.stderr.strip() if free.returncode else ""


class PowerDisk:
    """An ext4 file system in a file, which can lose its power.

    Args:
        folder: Where it is mounted; the file is beside it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True)
        image = folder.with_suffix(".img")
        with image.open("wb") as file:
            file.truncate(DISK_BYTES)
        _call("mkfs.ext4", "-q", "-F", "-E", "lazy_itable_init=0,lazy_journal_init=0", str(image))
        self._device = _call("losetup", "--find", "--show", "--direct-io=on", str(image)).strip()
        _call("mount", self._device, str(folder))

    def sync(self) -> None:
        """Let everything that is here now outlive the next cut."""
        _call("sync", "--file-system", str(self.folder))

    def cut(self) -> None:
        """Stop at once: nothing that is only in memory reaches the disk any more."""
        descriptor = os.open(self.folder, os.O_RDONLY)
        try:
            ioctl(descriptor, SHUTDOWN, struct.pack("I", WITHOUT_LOG))
        finally:
            os.close(descriptor)

    def power_up(self) -> None:
        """Mount the disk as it was when it lost its power; all processes that use it are killed."""
        self._unmount()
        _call("mount", self._device, str(self.folder))

    def close(self) -> None:
        """Kill what uses the disk, and give it back."""
        self._unmount()
        _call("losetup", "--detach", self._device)

    def _unmount(self) -> None:
        until_s = now_s() + UNMOUNT_S
        while True:
            users = [each for each in psutil.process_iter() if works_in(each, self.folder)]
            for process in users:
                with suppress(psutil.Error):
                    process.kill()
            psutil.wait_procs(users, timeout=30)
            try:
                _call("umount", str(self.folder))
            except subprocess.CalledProcessError:
                if now_s() > until_s:
                    raise
                time.sleep(POLL_S)
            else:
                return


def _call(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


@dataclass
class Cut:
    """What a power cut came to.

    Attributes:
        open: The iteration that was driven; the checkpoint with this number was the newest one.
        left: The newest checkpoint that is whole, -1 if none is.
        history: Iterations in the history; -1 if it cannot be read.
        traces: Finished iterations whose trace is missing or empty.
        empty: Objects without content.
        findings: What should not be.
    """

    open: int
    left: int
    history: int
    traces: list[int]
    empty: list[str]
    findings: list[str] = field(default_factory=list)


class PowerCuts:
    """A training whose machine loses its power again and again, with its disk.

    Args:
        folder: For everything; does not exist yet.
        seed: Chooses the moments.
        shipped: Whether to train with the files of `defaults/`; otherwise with small iterations.
        last: Iterations after the last cut.
        workers: DR_WORKERS.
        tell: Takes a line about what happens.
    """

    def __init__(
        self,
        folder: Path,
        seed: int = 1,
        *,
        shipped: bool = False,
        last: int = 2,
        workers: int = 1,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        folder.mkdir(parents=True)
        self._random = random.Random(seed)
        self._last = last
        self._workers = workers
        self._tell = tell
        self.disk = PowerDisk(folder / "disk")
        self.storage = Storage(self.disk.folder / "s3", disk=False)
        self.machine = Machine(
            self.disk.folder / "machine",
            self.storage,
            cloud="local",
            iterations=100_000,
            workers=workers,
            shipped=shipped,
        )
        self._iteration_s = 1.0

    @property
    def bucket(self) -> FolderBucket:
        """The objects, as any process on the machine reads them now."""
        return self.storage.bucket

    def run(self, cuts: int) -> list[Cut]:
        """Train, with so many power cuts; each is followed by a start that continues."""
        self.disk.sync()
        done: list[Cut] = []
        for number in range(1, cuts + 1):
            self.machine.start("--resume" if done else "--resume-or-start")
            first = done[-1].left if done else 0
            self._wait_for(first + 2)
            self._pass(self._random.uniform(0.0, 2.0) * self._iteration_s)
            done.append(self._cut())
            if done[-1].left < 0:
                return done
            self._tell(f"cut {number}: {done[-1]}")
        self.machine.start("--resume")
        self._wait_for(done[-1].left + self._last)
        subprocess.run([self.machine.dr, "stop-training"], cwd=self.machine.folder, check=True)
        assert self.machine.process is not None
        self.machine.process.wait(PATIENCE_S)
        return done

    def audit(self) -> list[str]:
        """What the auditor finds in the model."""
        return Audit(self.bucket, PREFIX, self._workers).run()

    def close(self) -> None:
        """End everything."""
        server.not_in_use(self.storage.folder)
        self.disk.close()
        self.machine.vanish()

    def _pointed(self) -> int:
        pointed = CheckpointStore(ModelStore(self.bucket, PREFIX)).pointed()
        return -1 if pointed is None else pointed.number

    def _wait_for(self, number: int) -> None:
        """Wait until a checkpoint is published, and note how long an iteration takes."""
        until_s, before_s, before = now_s() + PATIENCE_S, now_s(), self._pointed()
        while (pointed := self._pointed()) < number:
            if pointed > before >= 0:
                self._iteration_s = now_s() - before_s
            if pointed != before:
                before_s, before = now_s(), pointed
            said = self.machine.said_path.read_text(errors="replace")
            assert self.machine.running, said
            assert now_s() < until_s, said
            time.sleep(POLL_S)

    def _pass(self, seconds: float) -> None:
        until_s = now_s() + seconds
        while now_s() < until_s:
            time.sleep(0.001)

    def _cut(self) -> Cut:
        pointed = self._pointed()
        unflushed = self.disk.folder / "unflushed"
        unflushed.write_text("lost")
        self.disk.cut()
        server.not_in_use(self.storage.folder)
        self.disk.power_up()
        assert self.machine.process is not None
        self.machine.process.wait()
        left = self._newest_whole()
        cut = Cut(pointed, left, self._history(), self._lost_traces(left), self._empty())
        if unflushed.exists() and unflushed.read_text():
            cut.findings.append("what nobody has flushed is still there: this was no power cut")
        if left < pointed - 1:
            cut.findings.append(f"checkpoint {pointed} was published, {left} is left")
        if left >= 0 and cut.history < left - 1:  # the checkpoint has one more
            cut.findings.append(f"the history has {cut.history} iterations of {left}")
        if cut.traces:
            cut.findings.append(f"the traces of {cut.traces} are lost")
        return cut

    def _newest_whole(self) -> int:
        store = CheckpointStore(ModelStore(self.bucket, PREFIX))
        for name in sorted(
            set(checkpoint_objects(ModelStore(self.bucket, PREFIX)).values()), reverse=True
        ):
            with suppress(ObjectMissing, ObjectDamaged):
                found = store.load(str(name), with_optimizer=True)
                if found.optimizer is not None or name.number == 0:
                    return name.number
        return -1

    def _history(self) -> int:
        try:
            return len(read_history(ModelStore(self.bucket, PREFIX)))
        except DrError:
            return -1

    def _lost_traces(self, finished: int) -> list[int]:
        traced = ModelListing(ModelStore(self.bucket, PREFIX)).traces
        whole = [n for n, own in traced.items() if all(map(self.bucket.get, own.values()))]
        return [n for n in range(finished) if n not in whole]

    def _empty(self) -> list[str]:
        listed = [info.key for info in self.bucket.list("") if not info.size_bytes]
        return [key for key in listed if not key.startswith("rollouts/") and "/status/" not in key]
