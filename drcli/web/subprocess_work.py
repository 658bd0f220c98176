"""Runs heavy work of a task in a process of its own.

Libraries for learning, films and tables take seconds and hundreds of megabytes; the process ends
with the work. Its priority is low, because a training may be running.
"""

import multiprocessing
import threading
from collections.abc import Callable
from contextlib import nullcontext
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

from drcli.base import errors
from drcli.base.errors import DrError, WorkerDied
from drcli.base.json_record import plain
from drcli.base.processes import Stopped, lower_priority, until_sigterm
from drcli.config import secret_environment
from drcli.web.answers import error_of
from drcli.web.tasks import Progress

MOST_HEAVY = 2
_heavy = threading.Semaphore(MOST_HEAVY)

_heavy_ones: set[SpawnProcess] = set()
Work = Callable[..., Any]
"""Takes a `Progress` first, then what can be pickled."""


class WorkFailed(DrError):
    """In another process."""

    def __init__(self, message: str, *, remedy: str, code: int) -> None:
        super().__init__(message, remedy=remedy)
        self.code = code  # type: ignore[misc]  # that of the first error


def in_subprocess(progress: Progress, work: Work, *arguments: Any, heavy: bool = True) -> Any:
    """Run a function in another process, and return its plain data or raise its error.

    A `heavy` one gets a low priority and ends with the console, as would a training that it starts.
    """
    with _heavy if heavy else nullcontext():
        return _run(progress, work, arguments, heavy=heavy)


def end_heavy() -> None:
    """End the processes that compute.

    The others go on: what they start or delete must not stay half.
    """
    for process in list(_heavy_ones):
        process.terminate()


def _run(progress: Progress, work: Work, arguments: tuple[Any, ...], *, heavy: bool) -> Any:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    # Arguments travel through a pipe, so secrets are neither in the environment nor in `ps`.
    secrets = secret_environment.all_secrets()
    process = context.Process(
        target=_work, args=(there, secrets, work, arguments, heavy), daemon=True
    )
    process.start()
    if heavy:
        _heavy_ones.add(process)
    there.close()
    try:
        while True:
            kind, value = here.recv()
            if kind == "text":
                progress(value)
            elif kind == "done":
                return value
            else:
                raise WorkFailed(value["message"], remedy=value["remedy"], code=value["code"])
    except EOFError:
        process.join(5.0)
        raise WorkerDied(
            f"The process of this task ended early (exit code {process.exitcode}).",
            remedy="Look for free memory with `free -h`, then try again.",
        ) from None
    finally:
        here.close()
        _heavy_ones.discard(process)
        if process.is_alive():
            process.join(2.0)
        if process.is_alive():
            process.terminate()
        process.join()


def _work(
    there: Connection,
    secrets: dict[str, str],
    work: Work,
    arguments: tuple[Any, ...],
    heavy: bool,
) -> None:
    secret_environment.keep(secrets)
    if secrets:
        secret_environment.hide_process()
    if heavy:
        lower_priority()

    def tell(kind: str, value: Any) -> None:
        try:
            there.send((kind, value))
        except BrokenPipeError:  # the console has ended
            if heavy:
                raise Stopped("The console has ended.", remedy="") from None

    def progress(text: str) -> None:
        tell("text", text)

    errors.show = errors.warn = progress
    try:
        with until_sigterm("The console has ended.", "") if heavy else nullcontext():
            tell("done", plain(work(progress, *arguments)))
    except Stopped:
        pass  # whoever stops it says so
    except Exception as error:
        tell("failed", error_of(error)["error"])
