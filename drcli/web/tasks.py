"""What was started on the page and takes longer than an answer may: start, evaluate, export, film.

A task calls the same function as the command. The page shows the newest tasks with their sentences.
"""

import itertools
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Literal

from drcli.base.plain_json import plain
from drcli.web.answers import BadRequest, error_of
from drcli.web.topics import Snapshot

MOST_KEPT = 50
"""Tasks in the list; the oldest that have ended are forgotten."""

MOST_AT_ONCE = 12
"""Tasks that run at the same time; others wait. Most of them wait for another process."""

MOST_WAITING = 40
"""More are refused: nobody waits for that many."""

TaskState = Literal["waiting", "running", "done", "failed"]

Progress = Callable[[str], None]
"""Shows a short sentence about what a task does."""


@dataclass(frozen=True)
class Task:
    """One task.

    Attributes:
        kind: What it does, such as "start-training".
        subject: Prefix of the model that it is about; empty for none.
        title: One line for people.
        text: What it does now, or how it ended.
        result: What it made; null before its end.
        error: As of an answer that failed; null otherwise.
        began: Unix seconds.
        ended: Unix seconds; null while it runs.
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


class Tasks:
    """The tasks of a console, in threads. Any thread may call its methods."""

    def __init__(self, publish: Callable[[str, Snapshot], None]) -> None:
        """Args: publish: Gives the list to the page."""
        self._publish = publish
        self.closing = threading.Event()
        """Set when the console ends: its process waits for the threads of its tasks."""
        self._numbers = itertools.count(1)
        self._tasks: dict[int, Task] = {}
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(MOST_AT_ONCE, thread_name_prefix="task")

    def start(
        self, kind: str, subject: str, title: str, function: Callable[[Progress], Any]
    ) -> Task:
        """Run a function in a thread.

        Args:
            kind: What it does, such as "start-training".
            subject: Prefix of the model that it is about; empty for none.
            title: One line for people.
            function: Its result is a dataclass or plain data; a `DrError` becomes the task's error.

        Raises:
            BadRequest: The same is under way, or too much is.
        """
        with self._lock:
            open_tasks = [task for task in self._tasks.values() if task.ended is None]
            if any((task.kind, task.subject) == (kind, subject) for task in open_tasks):
                raise BadRequest(f"{title}: this is already under way.", 409)
            if len(open_tasks) >= MOST_WAITING:
                raise BadRequest("Too many tasks are under way; wait for one to end.", 429)
            task = Task(next(self._numbers), kind, subject, title, began=time.time())
            self._tasks[task.id] = task
            for old in [each.id for each in self._tasks.values() if each.ended is not None]:
                if len(self._tasks) > MOST_KEPT:
                    del self._tasks[old]
        self._show()
        self._pool.submit(self._run, task.id, function)
        return task

    def find(self, number: int) -> Task:
        """A task.

        Raises:
            BadRequest: There is none of this number.
        """
        with self._lock:
            task = self._tasks.get(number)
        if task is None:
            raise BadRequest(f"There is no task {number}.", 404)
        return task

    def snapshot(self) -> Snapshot:
        """All tasks, the newest first."""
        with self._lock:
            tasks = sorted(self._tasks.values(), key=lambda task: -task.id)
        return Snapshot.of("tasks", {"tasks": tasks})

    def close(self) -> None:
        """Start no more tasks, and let those that only wait end."""
        self.closing.set()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _run(self, number: int, function: Callable[[Progress], Any]) -> None:
        self._change(number, state="running")
        try:
            result = plain(function(lambda text: self._change(number, text=text)))
        except Exception as error:
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
