"""Runs one command for the supervisor of a training.

Arguments and secrets come through standard input: the racer's code can read command line and
environment of the user's other processes.
"""

import json
import os
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

from drcli.base.installation import lazy_imports

with lazy_imports():
    from drcli.bucket import request_count
    from drcli.cli import app
    from drcli.config import secret_environment

NICENESS = 15
"""19 is the most."""

POLL_S = 1.0


def main() -> None:
    """Run the command.

    Raises:
        SystemExit: Always, with its exit code.
    """
    call = json.loads(sys.stdin.buffer.read())
    with Path(os.devnull).open("rb") as nothing:
        os.dup2(nothing.fileno(), sys.stdin.fileno())
    with suppress(OSError):
        os.nice(NICENESS)
    threading.Thread(target=_end_with, args=(call["caller"],), daemon=True).start()

    secret_environment.keep(call["secrets"])
    requests = request_count.CountFile(Path(call["folder"]), "commands", call["session"])
    requests.start()
    try:
        app.main(call["arguments"])
    finally:
        requests.end()


def _end_with(caller: int) -> None:
    while os.getppid() == caller:
        time.sleep(POLL_S)
    os._exit(1)


if __name__ == "__main__":
    main()
