"""Lets a process of its own call the racer's reward function for the cars of a worker.

The racer's code cannot reach the worker's keys and memory, and whatever it starts ends with it.
A step costs two messages: docs/benchmarks.md.
"""

import io
import json
import os
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import IO, NoReturn, get_args

from drcli.base.confinement import FREEDOMS
from drcli.base.framing import WireError, framed, receive
from drcli.base.json_record import RecordError
from drcli.base.log import get_logger
from drcli.base.processes import end_like
from drcli.config import secret_environment
from drcli.drive.reward_access import SCRATCH, freedoms_told
from drcli.records.job import LOG_ENCODING
from drcli.records.reward import MOST_BYTES, CallFailure, Calls, Load, RewardResponse
from drcli.workers import print_limit
from drcli.workers.heartbeat_thread import companions
from drsim.episode.reward import OnRewardError, Rewarded, RewardHost, RewardParams
from drsim.episode.reward_deadline import STUCK
from drsim.errors import RewardError, RewardErrorKind

SERVER = "drcli.drive.reward_server"

_LOAD_S = 120.0
"""The process interrupts it before."""

_PATIENCE_S = 300.0
"""Beyond what is allowed: the process ends calls by processor time, of which a busy machine has
little.
"""

_EXIT_S = 2.0
_LONGEST_LINE = 1 << 16

_logger = get_logger(__name__)


class RewardProcess(RewardHost):
    """The process of the reward functions of some cars, each with its own copy.

    `file` is in a folder of this process alone.

    Raises:
        RewardError: The file cannot be loaded.
    """

    def __init__(self, file: Path, cars: int) -> None:
        self.cars = cars
        self._file = file
        self._pid: int | None = None
        self._waypoints: set[bool] = set()
        self._connection, theirs = socket.socketpair()
        plain, _ = secret_environment.split(os.environ)
        with theirs:
            self._process = subprocess.Popen(
                [
                    *(sys.executable, "-P", "-m", "drcli.base.start_module", SERVER),
                    *(str(theirs.fileno()), str(os.getpid())),
                ],
                env={**plain, **LOG_ENCODING},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        assert self._process.stdout is not None
        relay = partial(_relay, self._process.stdout)
        self._relay = threading.Thread(target=relay, name="reward-prints", daemon=True)
        self._relay.start()
        try:
            loaded = self._ask(Load(str(file.resolve()), cars).encode(), 0, cars * _LOAD_S)
            for failure in loaded.failures:
                raise _error(failure)
        except BaseException:
            self.close()
            raise
        told = freedoms_told([each for each in FREEDOMS if each in loaded.free])
        if told:
            _logger.warning("%s", told)
        self._pid = loaded.pid
        if self._pid is not None:
            companions.add(self._pid)
        _logger.info("The reward function runs in process %s.", self._pid)

    def rewards(
        self,
        cars: Sequence[int],
        calls: Iterable[RewardParams],
        deadline_s: float,
        on_error: OnRewardError,
    ) -> Rewarded:
        params = list(calls)
        new: dict[bool, list[tuple[float, float]]] = {}
        for each in params:
            way = each["is_reversed"]
            if way not in self._waypoints:
                self._waypoints.add(way)
                new[way] = each["waypoints"]
            each["waypoints"] = None  # its place in the dictionary stays
        message = Calls(list(cars), params, deadline_s, new).encode()
        answer = self._ask(message, len(params), len(params) * deadline_s + _PATIENCE_S)
        for failure in answer.failures:
            error = _error(failure)
            if error.kind == "endless":
                raise error
            answer.rewards[failure.call] = on_error(failure.call, error)
        return Rewarded(answer.rewards, answer.seconds)

    def close(self) -> None:
        """End the process, and remove its temporary files; may be repeated."""
        self._connection.close()
        try:
            self._process.wait(_EXIT_S)
        except subprocess.TimeoutExpired:
            self._process.terminate()
            self._process.wait()
        self._relay.join(_EXIT_S)
        companions.discard(self._pid or 0)
        shutil.rmtree(self._file.parent / SCRATCH, ignore_errors=True)

    def _ask(self, message: bytes, calls: int, within_s: float) -> RewardResponse:
        self._connection.settimeout(within_s)
        try:
            self._connection.sendall(framed(message))
            return RewardResponse.decode(receive(self._connection, MOST_BYTES), calls)
        except TimeoutError:
            if self._pid is not None and STUCK is not None:
                os.kill(self._pid, STUCK)  # it shows where it is, and ends
                self._end_alike()
            self.close()
            what = f"it did not return within {within_s:g} s, and nothing can interrupt it"
            raise RewardError(
                f"The reward function failed: {what}.", kind="endless", reason=what
            ) from None
        except (WireError, RecordError, OSError):
            self._end_alike()

    def _end_alike(self) -> NoReturn:
        """As the racer's code has ended: whoever watches this worker knows what helps."""
        self.close()  # it may have damaged the connection and live on
        code = self._process.returncode
        _logger.error("The process of the reward function has ended: %d.", code)
        end_like(code or 1)


def _relay(pipe: IO[bytes]) -> None:
    with io.TextIOWrapper(pipe, "utf-8", "backslashreplace", newline="") as lines:
        for line in iter(lambda: lines.readline(_LONGEST_LINE), ""):
            print_limit.theirs.write(line)


def _error(failure: CallFailure) -> RewardError:
    kinds = get_args(RewardErrorKind)
    error = RewardError(
        failure.message,
        kind=kinds[kinds.index(failure.kind)],
        reason=failure.reason,
        file=None if failure.file is None else Path(failure.file),
        line=failure.line,
        source=failure.source,
        params=json.loads(failure.params),
    )
    if failure.cause:
        cause = MemoryError if failure.out_of_memory else type(failure.cause, (Exception,), {})
        error.__cause__ = cause(failure.reason)
    return error
