"""Runs one command for the supervisor of a training, as `python -m drcli.cli.called_command`.

The arguments, and the secrets that the command may need, come through standard input: the racer's
code can read the command line and the environment of other processes of the same user.
"""

import json
import os
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

NICENESS = 15
"""Such a command gives way to the training; 19 is the most that the system knows."""

LOOK_S = 1.0
"""How often it checks that its caller is alive."""


def main() -> None:
    """Run the command that standard input describes.

    Raises:
        SystemExit: Always, with its exit code.
    """
    call = json.loads(sys.stdin.buffer.read())
    with Path(os.devnull).open("rb") as nothing:
        os.dup2(nothing.fileno(), sys.stdin.fileno())
    with suppress(OSError):
        os.nice(NICENESS)
    threading.Thread(target=_end_with, args=(call["caller"],), daemon=True).start()

    from drcli.cli.app import main as run
    from drcli.config import secret_environment
    from drcli.store.request_count import CountFile

    secret_environment.keep(call["secrets"])
    requests = CountFile(Path(call["folder"]), "commands", call["session"])
    requests.start()
    try:
        run(call["arguments"])
    finally:
        requests.end()


def _end_with(caller: int) -> None:
    """End this process soon after its caller has ended, even if that was killed."""
    while os.getppid() == caller:
        time.sleep(LOOK_S)
    os._exit(1)


if __name__ == "__main__":
    main()
