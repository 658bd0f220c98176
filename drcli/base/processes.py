"""Identifies machines, and processes whose number may be used again.

Containers share host name and /etc/machine-id, so a machine is the kernel's boot id and a namespace
of process numbers.
"""

import gc
import hashlib
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from types import FrameType
from typing import Any, ClassVar, NoReturn

from drcli.base.clock import wait_until
from drcli.base.errors import DrError
from drcli.base.installation import lazy_imports
from drcli.base.system_calls import ExitWait, adopt_orphans, end_with_parent

with lazy_imports():
    import psutil

_PROC = Path("/proc")
_START_FIELD = 19
"""Source: man 5 proc."""

_UNIX_S = 1e9
_SAME_S = 1.0


@lru_cache(maxsize=1)
def this_machine() -> str:
    """Equal for processes that see each other's numbers."""
    host = socket.gethostname()
    try:
        boot = (_PROC / "sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {(_PROC / 'self/ns/pid').readlink()} {host}"
    except OSError:  # not Linux; containers there run on a Linux of their own
        return f"booted {psutil.boot_time():.0f} {host}"


def started_s(pid: int) -> float | None:
    """Seconds from the machine's start, or Unix time without /proc; None for a zombie."""
    try:
        after_name = (_PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()
        if after_name[0] in "ZX":
            return None
        return int(after_name[_START_FIELD]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return _started_unix_s(pid)


def exists(pid: int) -> bool:
    return started_s(pid) is not None


def is_alive(pid: int, began_s: float) -> bool:
    """Began then (`started_s` or Unix time)."""
    now_s = _started_unix_s(pid) if began_s > _UNIX_S else started_s(pid)
    return now_s is not None and abs(now_s - began_s) < _SAME_S


def _started_unix_s(pid: int) -> float | None:
    try:
        process = psutil.Process(pid)
        ended = process.status() == psutil.STATUS_ZOMBIE
        return None if ended else process.create_time()
    except (psutil.Error, ValueError, OverflowError):  # the others: not a process id
        return None


# Ends whatever a process has started, in whatever session.
#
# Linux gives orphans to the nearest ancestor that wants them, where they are found.


_POLL_S = 0.2


class _Asked(BaseException):
    """SIGTERM."""


def keep_descendants(parent_pid: int) -> None:
    """Go on in a child; this process waits for its end, and then ends all that is left.

    The child leads a process group, and is killed at the end of `parent_pid`, or at SIGTERM. Then
    this process ends as the child did. Outside Linux, what has left the group may go on.

    Only for a process without other threads.
    """
    adopt_orphans()
    own = os.getpid()
    child = os.fork()
    if not child:
        os.setpgid(0, 0)
        end_with_parent()
        if os.getppid() != own:
            os._exit(1)
        return
    code = 1
    try:
        code = os.waitstatus_to_exitcode(_end_of(child, parent_pid))
        _end_others(child)
    finally:
        end_like(code)


def end_like(code: int) -> NoReturn:
    """End this process at once as another one, whose code is negative for a signal, has ended."""
    if code < 0:
        with suppress(OSError):  # SIGKILL cannot be set
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code & 0xFF)


def _end_of(child: int, parent_pid: int) -> int:
    def stop(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise _Asked

    ended = ExitWait(child)
    with suppress(_Asked):
        signal.signal(signal.SIGTERM, stop)
        while os.getppid() == parent_pid:
            ended.wait(_POLL_S)
            found, status = os.waitpid(child, os.WNOHANG)
            if found:
                signal.signal(signal.SIGTERM, signal.SIG_IGN)
                return status
    with suppress(ProcessLookupError):
        os.kill(child, signal.SIGKILL)
    return os.waitpid(child, 0)[1]


def _end_others(group: int) -> None:
    with suppress(OSError):
        os.killpg(group, signal.SIGKILL)
    with suppress(ChildProcessError):  # nobody is left
        while True:
            if os.waitpid(-1, os.WNOHANG)[0]:
                continue
            for each in psutil.Process().children(recursive=True):
                with suppress(psutil.Error):
                    each.kill()
            os.waitpid(-1, 0)


# Lowers the priority of this process and its descendants.


NICE = 10
"""A program with 0 gets nine times as much of a core. Source: man 7 sched."""

_GROUP = Path("/proc/self/autogroup")

_GROUP_PATIENCE_S = 1.0


def lower_priority(group: Path = _GROUP) -> str:
    """Let others have processor and disk first, for good; returns what was done.

    Call it before threads start: on Linux, they inherit priority.

    With `sched_autogroup` (most desktops), priority counts within a session only. So the session's
    group gets the same priority, unless others share the session, such as a shell.
    """
    done = []
    with suppress(OSError):
        if os.getpriority(os.PRIO_PROCESS, 0) < NICE:
            os.setpriority(os.PRIO_PROCESS, 0, NICE)
        done.append(f"nice {os.getpriority(os.PRIO_PROCESS, 0)}")
    if os.getsid(0) == os.getpid() and group.exists() and _lower_group(group):
        done.append("its session too")
    if _lower_disk():
        done.append("disk last of its class")
    return ", ".join(done) or "this system allows no other priority"


def _lower_group(group: Path) -> bool:
    def lowered() -> bool:
        try:
            if int(group.read_text("ascii").rpartition(" ")[2]) < NICE:
                group.write_text(str(NICE), "ascii")
        except BlockingIOError:  # another group was changed just now
            return False
        return True

    try:
        return wait_until(lowered, patience_s=_GROUP_PATIENCE_S, last_s=0.2)
    except (OSError, ValueError):
        return False


def _lower_disk() -> bool:
    if sys.platform != "linux":
        return False

    try:
        psutil.Process().ionice(psutil.IOPRIO_CLASS_BE, 7)
    except (psutil.Error, OSError, ValueError):
        return False
    return True


# Lets SIGTERM and SIGHUP end work with cleanup, as Ctrl-C does.


STOPS = (signal.SIGTERM, signal.SIGHUP)
Handlers = Mapping[signal.Signals, Any]


class Stopped(DrError):
    """By SIGTERM or SIGHUP."""

    code: ClassVar[int] = 143
    final: ClassVar[bool] = True


class Interrupted(Stopped):
    """By Ctrl-C, with a sentence that says what is left."""

    code: ClassVar[int] = 130


class _Terminated(BaseException):
    """Not an Exception, so that `except Exception` does not catch it."""


def handle(
    handler: Callable[[int, FrameType | None], object],
    numbers: tuple[signal.Signals, ...] = (signal.SIGINT, *STOPS),
) -> Handlers:
    """For the main thread. Returns what handled signals before, for `restore`.

    An ignored SIGHUP stays so, because of `nohup`.
    """
    kept = {signal.SIGHUP} if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else set()
    return {each: signal.signal(each, handler) for each in numbers if each not in kept}


def restore(before: Handlers) -> None:
    """Undo `handle`."""
    for number, handler in before.items():
        signal.signal(number, handler)


class NotedSignals:
    """Notes signals in its `with` block; in the main thread.

    Attributes:
        count: SIGHUP counts only as the first: a shell repeats it.
    """

    def __init__(self) -> None:
        self.first: signal.Signals | None = None
        self.count = 0

    def __enter__(self) -> "NotedSignals":
        self._before = handle(self._note)
        return self

    def __exit__(self, *_error: object) -> None:
        restore(self._before)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if self.first is not None and number == signal.SIGHUP:
            return
        self.first = self.first or signal.Signals(number)
        self.count += 1

    def refuse(self, message: str, remedy: str) -> None:
        """Raise KeyboardInterrupt or Stopped if a signal has come."""
        if self.first == signal.SIGINT:
            raise KeyboardInterrupt
        if self.first is not None:
            raise Stopped(message, remedy=remedy)


@contextmanager
def until_sigterm(message: str, remedy: str) -> Iterator[None]:
    """Stopped ends the `with` block; main thread only."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise _Terminated

    before = handle(stop, STOPS)
    try:
        yield
    except _Terminated:
        raise Stopped(message, remedy=remedy) from None
    finally:
        restore(before)


# How often Python searches for garbage.
#
# In imports, that takes a sixth of a worker's start.


_RARE = 50_000
"""Python's own number is about 700."""

_USUAL = gc.get_threshold()


def search_rarely() -> None:
    gc.set_threshold(_RARE)


def search_as_usual() -> None:
    gc.freeze()
    gc.set_threshold(*_USUAL)


# Ends the pause of another process; Linux only.
#
# A wake-up may be lost, so pauses end in any case. Sockets have abstract names, so no file stays.


_MOST_QUEUED = 1_000


class Wakeup:
    """Close it when done.

    Attributes:
        works: If not, `pause` only waits.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.works = False
        self._socket: socket.socket | None = None
        if sys.platform != "linux":
            return
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        listener.setblocking(False)
        try:
            listener.bind(_address(folder, name))
        except OSError:  # a process of an earlier start still has that name
            listener.close()
            return
        self._socket, self.works = listener, True

    def pause(self, seconds: float) -> bool:
        """Wait until woken, and return whether so.

        A wake-up before the pause ends it at once.
        """
        if self._socket is None:
            time.sleep(seconds)
            return False
        if not select.select([self._socket], [], [], max(0.0, seconds))[0]:
            return False
        with suppress(OSError):
            for _ in range(_MOST_QUEUED):
                self._socket.recv(1)
        return True

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket, self.works = None, False


def wake(folder: Path, *names: str) -> None:
    if sys.platform != "linux":
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.setblocking(False)
        for name in names:
            with suppress(OSError):  # nobody listens, or it has enough wake-ups in its queue
                sender.sendto(b"w", _address(folder, name))


def _address(folder: Path, name: str) -> bytes:
    """At most 108 bytes."""
    key = hashlib.sha256(f"{folder.resolve()}\n{name}".encode()).hexdigest()[:32]
    return f"\0drcli-{key}".encode()
