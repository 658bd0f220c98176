"""Server processes that outlive the command."""

import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from drcli.base.backoff import wait_until

_TERM_PATIENCE_S = 5.0


def start_detached(
    command: Sequence[str], *, environment: Mapping[str, str], log: Path, folder: Path
) -> int:
    """Start a process that goes on after this one; its id.

    A shell starts it in a new session, prints its id and exits. So Ctrl-C and our end do not reach
    it, and it is never our zombie.
    """
    script = 'log=$1; shift; "$@" >>"$log" 2>&1 </dev/null & echo $!'
    shell = subprocess.run(
        ["/bin/sh", "-c", script, "sh", str(log), *command],
        env=dict(environment),
        cwd=folder,
        start_new_session=True,
        stdout=subprocess.PIPE,
        check=True,
    )
    return int(shell.stdout)


def is_running(pid: int, mark: str) -> bool:
    """Lives, with the mark in its command line.

    After a reboot, the id may be another's.
    """
    return mark in _command_line(pid)


def end(pid: int, mark: str) -> None:
    if not is_running(pid, mark):
        return
    os.kill(pid, signal.SIGTERM)
    if not wait_until(lambda: not is_running(pid, mark), patience_s=_TERM_PATIENCE_S):
        os.kill(pid, signal.SIGKILL)
        wait_until(lambda: not is_running(pid, mark), patience_s=_TERM_PATIENCE_S)


def _command_line(pid: int) -> str:
    if Path("/proc/self/cmdline").exists():  # Linux, where a small image may lack `ps`
        try:
            # Decoded like a path, so that the mark is found in any locale.
            return os.fsdecode(Path(f"/proc/{pid}/cmdline").read_bytes()).replace("\0", " ")
        except (FileNotFoundError, ProcessLookupError):
            return ""
    answer = subprocess.run(
        ["ps", "-ww", "-o", "command=", "-p", str(pid)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        check=False,
    )
    return os.fsdecode(answer.stdout)
