"""What Ray runs on a node: one `dr-start-worker` that ends with its actor.

Ray sends this class to nodes, which need nothing but drcli.
"""

import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

MOST_LINES = 2000


class WorkerHost:
    def __init__(
        self, arguments: Sequence[str], folder: str, secrets: Mapping[str, str], threads: int
    ) -> None:
        own = Path(folder)
        if not (own / "system.env").is_file():
            own = Path.home() / ".cache" / "drcli" / "ray" / re.sub(r"\W+", "-", folder)
            own.mkdir(parents=True, exist_ok=True)
        plain = {name: text for name, text in os.environ.items() if not name.startswith("DR_")}
        limits = {"DR_DIR": str(own)} if (own / "run.env").is_file() else {}
        self._lines: list[str] = []
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _PROGRAM, *arguments],
            cwd=own,
            env={**plain, **secrets, **limits, "DR_THREADS": str(threads), "NO_COLOR": "1"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def look(self) -> tuple[str, list[str], int | None]:
        """Name of the node, new lines, and the exit code; None while it runs."""
        code = self._process.poll()
        with self._lock:
            lines, self._lines = self._lines, []
        return socket.gethostname(), lines, code

    def stop(self) -> None:
        with suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGTERM)

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as pipe:
            for line in pipe:
                with self._lock:
                    self._lines.append(line.rstrip("\n"))
                    del self._lines[:-MOST_LINES]


_PROGRAM = "import sys; sys.argv[0] = 'dr-start-worker'; from drcli.cli.program import main; main()"
