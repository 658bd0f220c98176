"""The process that a racer's reward function is called in: it may end, hang or crash that.

Run as `python -m drcli.checks.sandbox.reward_process FOLDER`. FOLDER holds the order; the statement
is written there last, so that a missing one tells that it came to that.
"""

import faulthandler
import os
import resource
import signal
import sys
from pathlib import Path
from typing import NoReturn

from drcli.base import signal_guard
from drcli.checks.sandbox.calls import Guard
from drcli.checks.sandbox.recording import testify
from drcli.checks.sandbox.statement import FAULTS_FILE, ORDER_FILE, STATEMENT_FILE, Order

_MEMORY_BYTES = 16 << 30
"""Memory that may be asked for: a list that grows in an endless loop must not fill the machine."""


def _main(folder: Path) -> None:
    faults = (folder / FAULTS_FILE).open("w", encoding="utf-8", errors="backslashreplace")
    faulthandler.enable(faults)
    signal_guard.install()
    ends_at_once = os._exit

    def tell_and_end(status: int) -> NoReturn:
        faulthandler.dump_traceback(faults)
        ends_at_once(status)

    os._exit = tell_and_end
    # The switch of the guard would end this process before its own, which tells more.
    signal.signal(signal.SIGPROF, signal.SIG_IGN)
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = _MEMORY_BYTES if hard == resource.RLIM_INFINITY else min(_MEMORY_BYTES, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
    order = Order.model_validate_json((folder / ORDER_FILE).read_text("utf-8"))
    statement = testify(order, faults, Guard(faults, ends_at_once))
    unfinished = folder / f"{STATEMENT_FILE}.part"
    unfinished.write_text(statement.model_dump_json(), "utf-8")
    unfinished.rename(folder / STATEMENT_FILE)
    ends_at_once(0)  # racers' threads do not hold anything up


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
