"""Starts processes that load libraries before anybody knows what they shall do.

To load torch, MuJoCo and numba takes longer than all checks before a start. So a command starts
such a process first, which loads them meanwhile, and gives it an order when everything is checked:
a module to run as a program, with its arguments and log. Without an order, it ends. On Linux it can
divide itself before, so that several processes share what was loaded once.

An order is a line of JSON on standard input; what follows there belongs to the module.
"""

import gc
import json
import math
import os
import runpy
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import IO, Any

from drcli.base.system_calls import ExitWait, adopt_orphans, end_before_others, rename_process

_POLL_S = 0.2
"""How often to look whether a process has ended, on a system that does not tell."""

_ADOPTION_S = 30.0
"""How long to wait for a process that is divided off."""


class Divided:
    """A child process that was made by dividing this one, with methods as of `subprocess.Popen`."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: Any = None

    def poll(self) -> int | None:
        """The exit code, negative for a signal; None while it runs."""
        if self.returncode is None:
            with suppress(ChildProcessError):  # a signal handler has just asked the same
                found, status = os.waitpid(self.pid, os.WNOHANG)
                if found:
                    self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the exit code.

        Raises:
            subprocess.TimeoutExpired: It runs on.
        """
        end_s = math.inf if timeout is None else time.monotonic() + timeout
        ended = ExitWait(self.pid)
        try:
            while (code := self.poll()) is None:
                left_s = end_s - time.monotonic()
                if timeout is not None and left_s <= 0.0:
                    raise subprocess.TimeoutExpired(str(self.pid), timeout)
                ended.wait(min(left_s, _POLL_S))
            return code
        finally:
            ended.close()

    def send_signal(self, sig: int) -> None:
        """Send a signal if it runs."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, sig)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


ChildProcess = subprocess.Popen[bytes] | Divided


@dataclass(frozen=True)
class Order:
    """What a process shall do.

    Attributes:
        module: To run as a program.
        arguments: Its command line.
        log: File for all that it prints.
        environment: What is added to its environment.
    """

    module: str
    arguments: Sequence[str]
    log: str
    environment: Mapping[str, str]


@dataclass(frozen=True)
class Early:
    """A process that waits for an order, which it gets through a pipe."""

    process: ChildProcess
    pipe: IO[bytes]
    module: str

    def give(self, order: Order, more: bytes) -> ChildProcess:
        """Let it begin; `more` is for the module."""
        with suppress(BrokenPipeError), self.pipe as pipe:  # it may have ended already
            pipe.write(json.dumps(asdict(order)).encode() + b"\n" + more)
        return self.process

    def dismiss(self) -> None:
        """End it; those that it has divided off end themselves."""
        self.process.kill()  # before it sees the end of the pipe and ends by itself
        self.pipe.close()
        self.process.wait()


_waiting: list[Early] = []
_announced: dict[str, socket.socket] = {}
"""Connections to those that this process is going to adopt, by module."""


def start(command: Sequence[str], module: str, first: str, **options: Any) -> None:
    """Start a process that waits for an order to run a module.

    Args:
        command: Program and arguments; it gets one more, for `divide_off`, and calls `obey`.
        module: What it may be ordered to run.
        first: What the process may run that it divides off first.
        options: Of `subprocess.Popen`.
    """
    adopt_orphans()
    ours, theirs = socket.socketpair()
    with theirs:
        process = subprocess.Popen(
            [*command, str(theirs.fileno())],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            pass_fds=[theirs.fileno()],
            **options,
        )
    assert process.stdin is not None
    pipe, process.stdin = process.stdin, None
    _waiting.append(Early(process, pipe, module))
    _announced[first] = ours


def divide_off(descriptor: int) -> None:
    """Make a copy of this process that waits for an order of the one that has started this one.

    It becomes a child of that process, whose connection the descriptor is. Only for a process
    without threads of Python's own.
    """
    parent = os.getppid()
    between = os.fork()
    if between:
        os.waitpid(between, 0)
        os.close(descriptor)
        return
    between = os.getpid()
    if os.fork():
        os._exit(0)
    while os.getppid() == between:
        time.sleep(0.001)
    if os.getppid() != parent:
        os._exit(1)
    os.setsid()
    os.dup2(descriptor, 0)
    os.close(descriptor)
    os.write(0, f"{os.getpid()}\n".encode())
    obey()
    sys.exit()


def divide(module: str) -> None:
    """Make a copy of this process that waits for an order to run a module, in its own session.

    The copy loads the module while the others load theirs, and ends afterwards. Only for a process
    without threads of Python's own.
    """
    gc.freeze()  # a search for garbage would write to memory that all of them share
    read, write = os.pipe()
    pid = os.fork()
    if not pid:
        for other in _waiting:
            other.pipe.close()
        _waiting.clear()
        os.close(write)
        os.dup2(read, 0)
        os.close(read)
        os.setsid()
        end_before_others()  # this one seems to have all the memory that they share
        load(module)
        obey()
        sys.exit()
    os.close(read)
    _waiting.append(Early(Divided(pid), os.fdopen(write, "wb"), module))


def taken(module: str) -> Early | None:
    """A process that runs and waits to run this module, for the caller; None if there is none."""
    if (connection := _announced.pop(module, None)) is not None:
        _adopt(connection, module)
    for early in _waiting:
        if module == early.module and early.process.poll() is None:
            _waiting.remove(early)
            return early
    return None


def _adopt(connection: socket.socket, module: str) -> None:
    """Wait for a process that is divided off."""
    pipe = connection.makefile("wb")
    with connection, suppress(OSError, ValueError):
        connection.settimeout(_ADOPTION_S)
        pid = int(connection.recv(32))
        connection.settimeout(None)
        _waiting.append(Early(Divided(pid), pipe, module))
    adopt_orphans(False)


def dismiss() -> None:
    """End all processes that wait for an order of this one."""
    while _announced:
        _announced.popitem()[1].close()
        adopt_orphans(False)
    while _waiting:
        _waiting.pop().dismiss()


def load(*modules: str) -> None:
    """Import these modules. If one fails, it does so again, and says why, when it is run."""
    with suppress(Exception):
        for module in modules:
            import_module(module)


def obey() -> None:
    """Wait for an order, and run the module that it names; return without one."""
    line = sys.stdin.buffer.readline()
    if not line.endswith(b"\n"):
        return
    order = Order(**json.loads(line))
    with Path(order.log).open("ab") as log:  # append, because several processes may share it
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
    os.environ.update(order.environment)
    sys.argv = [order.module, *order.arguments]
    rename_process(["-m", *sys.argv])
    sys.modules.pop(order.module, None)  # it is about to be `__main__`
    runpy.run_module(order.module, run_name="__main__", alter_sys=True)
