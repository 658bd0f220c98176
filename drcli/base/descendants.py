"""Ends whatever a process has started, in whatever session.

Linux gives orphans to the nearest ancestor that wants them, where they are found.
"""

import os
import signal
from contextlib import suppress
from types import FrameType

from drcli.base.system_calls import ExitWait, adopt_orphans, end_with_parent

_LOOK_S = 0.2


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
        if code < 0:
            with suppress(OSError):  # SIGKILL cannot be set
                signal.signal(-code, signal.SIG_DFL)
            os.kill(own, -code)
        os._exit(code & 0xFF)


def _end_of(child: int, parent_pid: int) -> int:
    def stop(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise _Asked

    ended = ExitWait(child)
    with suppress(_Asked):
        signal.signal(signal.SIGTERM, stop)
        while os.getppid() == parent_pid:
            ended.wait(_LOOK_S)
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
            import psutil  # loaded here: hardly ever is somebody left

            for each in psutil.Process().children(recursive=True):
                with suppress(psutil.Error):
                    each.kill()
            os.waitpid(-1, 0)
