"""What Ray runs on a node for a trainer.

Its files go back piece by piece, so nothing is lost with the node.
"""

import os
import shutil
import signal
import socket
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from drcli.base.errors import SettingsError
from drcli.base.json_record import from_json
from drcli.config import secret_environment
from drcli.exchange.job import Job, WorkerExit
from drcli.exchange.log_places import json_log, log_file
from drcli.exchange.pulse_record import PulseRecord
from drcli.runs.join_check import refuse_other_versions
from drcli.runs.unread_log import UnreadLog, read_piece
from drcli.runs.worker_processes import TRAINER, start_process
from drcli.tracking.open_sinks import tensorboard_folder

PIECE_BYTES = 1 << 20


@dataclass(frozen=True)
class HostReport:
    """What is new since the last look.

    `files` are whole, `log` and `events` what they have more. `refusal`: why this node may not
    train.
    """

    node: str
    code: int | None
    pulse: PulseRecord | None = None
    log: bytes = b""
    json_log: bytes = b""
    events: Mapping[str, bytes] = field(default_factory=dict)
    files: Mapping[str, bytes] = field(default_factory=dict)
    refusal: WorkerExit | None = None


class TrainerHost:
    def __init__(
        self, job: Mapping[str, Any], versions: Mapping[str, str], secrets: Mapping[str, str]
    ) -> None:
        self._refusal: WorkerExit | None = None
        try:
            refuse_other_versions(versions)
        except SettingsError as error:
            words = f"{socket.gethostname()} cannot train: {error}"
            self._refusal = replace(WorkerExit.of(error), message=words)
            return
        secret_environment.keep(secrets)
        self._folder = Path(tempfile.mkdtemp(prefix="drcli-trainer-"))
        sent = from_json(Job, dict(job))
        self._job = replace(
            sent,
            config=replace(sent.config, directory=self._folder),
            folder=self._folder / "run",
            launcher_pid=os.getpid(),
        )
        self._job.folder.mkdir()
        log = log_file(self._folder, self._job.config.model.prefix, TRAINER)
        self._log = UnreadLog(log, Path(os.devnull), PIECE_BYTES)
        self._json_log = UnreadLog(json_log(log), Path(os.devnull), PIECE_BYTES)
        self._events = tensorboard_folder(self._folder, self._job.config.model.prefix)
        self._sent_bytes: dict[str, int] = {}
        self._sent: dict[str, bytes] = {}
        self._process = start_process(self._job, TRAINER, "drcli.workers.trainer")

    def look(self) -> HostReport:
        node = socket.gethostname()
        if self._refusal is not None:
            return HostReport(node, self._refusal.code, refusal=self._refusal)
        code = self._process.poll()  # first, so that its last words are read below
        report = HostReport(
            node,
            code,
            PulseRecord.read(self._job.folder, TRAINER),
            _unread(self._log),
            _unread(self._json_log),
            self._new_events(),
            self._changed_files(),
        )
        if code is not None:  # who asks does not ask again
            shutil.rmtree(self._folder, ignore_errors=True)
        return report

    def stop(self) -> None:
        self.signal(signal.SIGTERM)

    def signal(self, number: int) -> None:
        with suppress(ProcessLookupError):
            self._process.send_signal(number)

    def _new_events(self) -> dict[str, bytes]:
        found = {}
        for path in sorted(self._events.glob("*")):
            begin = self._sent_bytes.get(path.name, 0)
            if data := read_piece(path, begin, PIECE_BYTES):
                found[path.name] = data
                self._sent_bytes[path.name] = begin + len(data)
        return found

    def _changed_files(self) -> dict[str, bytes]:
        found = {}
        for path in self._job.folder.iterdir():
            if not path.is_file() or path.suffix != ".json":
                continue
            data = path.read_bytes()
            if self._sent.get(path.name) != data:
                found[path.name] = self._sent[path.name] = data
        return found


def _unread(log: UnreadLog) -> bytes:
    found = []
    while log.log.exists():
        path, data = log.next_piece()
        if path is None:  # it was rotated just now
            continue
        if data:
            found.append(data)
            log.advance(len(data))
        elif path == log.log:
            break
        else:
            log.next_file()
    return b"".join(found)
