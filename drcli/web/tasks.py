"""What was started on the page and takes longer than an answer may.

Tasks call the functions of commands. Those that the end of a console cuts short are in its log, and
in the next console's list.
"""

import itertools
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from drcli.base.files import load_record, write_private_json
from drcli.base.json_record import plain
from drcli.base.log import get_logger
from drcli.base.processes import Stopped
from drcli.web.answers import BadRequest, error_of
from drcli.web.topics import Snapshot

_logger = get_logger(__name__)

MOST_KEPT = 50
MOST_AT_ONCE = 12
MOST_WAITING = 40
CLOSING_S = 1.0
_STOPPED = "The console was stopped before this was done."
_AGAIN = "Start it again if you need its result."

_GOES_ON = "The console was stopped while this was under way; it goes on without it."

TaskState = Literal["waiting", "running", "done", "failed"]

Progress = Callable[[str], None]
"""Shows a sentence."""


@dataclass(frozen=True)
class Task:
    """One task.

    Attributes:
        kind: Such as "start-training".
        subject: Prefix of its model, if any.
        title: One line for people.
        text: What it does, or how it ended.
        result: Null before its end.
        error: As of an answer that failed.
        began: Unix seconds.
        ended: Unix seconds.
        goes_on: Whether it is completed even if the console ends.
    """

    id: int
    kind: str
    subject: str
    title: str
    state: TaskState = "waiting"
    text: str = ""
    result: Any = None
    error: dict[str, Any] | None = None
    began: float = 0.0
    ended: float | None = None
    goes_on: bool = False


@dataclass(frozen=True)
class _CutShort:
    kind: str
    subject: str
    title: str
    began: float
    ended: float
    goes_on: bool


@dataclass(frozen=True)
class _AllCutShort:
    tasks: list[_CutShort]


class Tasks:
    """Runs in threads. Any thread may call it."""

    def __init__(self, publish: Callable[[str, Snapshot], None], kept: Path | None = None) -> None:
        """Take over tasks in `kept` that the last console's end cut short."""
        self._publish = publish
        self._kept = kept
        self.closing = threading.Event()
        """Set when the console ends: no more tasks begin, and those that only wait end."""
        self._numbers = itertools.count(1)
        self._tasks: dict[int, Task] = {}
        self._lock = threading.Lock()
        self._futures: set[Future[None]] = set()
        self._pool = ThreadPoolExecutor(MOST_AT_ONCE, thread_name_prefix="task")
        self._take_over()

    def start(
        self,
        kind: str,
        subject: str,
        title: str,
        function: Callable[[Progress], Any],
        *,
        goes_on: bool = False,
    ) -> Task:
        """Run a function in a thread, as a `Task`.

        It returns a dataclass or plain data; a `DrError` becomes the task's error.

        Raises:
            BadRequest: The same is under way, or too much is, or the console ends.
        """
        with self._lock:
            if self.closing.is_set():
                raise BadRequest("The console is being stopped.", 503)
            open_tasks = [task for task in self._tasks.values() if task.ended is None]
            if any((task.kind, task.subject) == (kind, subject) for task in open_tasks):
                raise BadRequest(f"{title}: this is already under way.", 409)
            if len(open_tasks) >= MOST_WAITING:
                raise BadRequest("Too many tasks are under way; wait for one to end.", 429)
            given = kind, subject, title
            task = Task(next(self._numbers), *given, began=time.time(), goes_on=goes_on)
            self._tasks[task.id] = task
            for old in [each.id for each in self._tasks.values() if each.ended is not None]:
                if len(self._tasks) > MOST_KEPT:
                    del self._tasks[old]
        self._show()
        future = self._pool.submit(self._run, task.id, function)
        self._futures.add(future)
        future.add_done_callback(self._futures.discard)
        return task

    def find(self, number: int) -> Task:
        with self._lock:
            task = self._tasks.get(number)
        if task is None:
            raise BadRequest(f"There is no task {number}.", 404)
        return task

    def snapshot(self) -> Snapshot:
        with self._lock:
            tasks = sorted(self._tasks.values(), key=lambda task: -task.id)
        return Snapshot.of("tasks", {"tasks": tasks})

    def close(self) -> None:
        """Wait a moment for tasks, and note those that are cut short.

        Call it after setting `closing` and ending their processes.
        """
        with self._lock:
            self.closing.set()
            begun = [task for task in self._tasks.values() if task.ended is None]
        self._pool.shutdown(wait=False, cancel_futures=True)
        wait(list(self._futures), timeout=CLOSING_S)
        with self._lock:
            after = [self._tasks[task.id] for task in begun]
        now = time.time()
        left = [
            # What did not begin does not go on.
            _CutShort(
                *(task.kind, task.subject, task.title, task.began, now),
                task.goes_on and before.state == "running",
            )
            for before, task in zip(begun, after, strict=True)
            if task.state != "done" or task.goes_on
        ]
        for each in left:
            _logger.warning("%s: %s", each.title, _GOES_ON if each.goes_on else _STOPPED)
        if left and self._kept is not None:
            with suppress(OSError):  # the log has them
                write_private_json(self._kept, asdict(_AllCutShort(left)))

    def _take_over(self) -> None:
        if self._kept is None:
            return
        kept = load_record(_AllCutShort, self._kept)
        with suppress(OSError):
            self._kept.unlink(missing_ok=True)
        for each in [] if kept is None else kept.tasks[-MOST_KEPT:]:
            said = _GOES_ON if each.goes_on else _STOPPED
            remedy = "" if each.goes_on else _AGAIN
            task = Task(
                next(self._numbers),
                *(each.kind, each.subject, each.title),
                state="failed",
                text=said,
                error={"message": said, "remedy": remedy, "code": Stopped.code},
                began=each.began,
                ended=each.ended,
                goes_on=each.goes_on,
            )
            self._tasks[task.id] = task

    def _run(self, number: int, function: Callable[[Progress], Any]) -> None:
        self._change(number, state="running")
        try:
            result = plain(function(lambda text: self._change(number, text=text)))
        except Exception as error:
            if self.closing.is_set():
                return  # `close` says what becomes of it
            found = error_of(error)["error"]
            self._change(
                number, state="failed", text=found["message"], error=found, ended=time.time()
            )
        else:
            self._change(number, state="done", result=result, ended=time.time())

    def _change(self, number: int, **changes: Any) -> None:
        with self._lock:
            self._tasks[number] = replace(self._tasks[number], **changes)
        self._show()

    def _show(self) -> None:
        self._publish("tasks", self.snapshot())
