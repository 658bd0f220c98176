"""Runs commands in processes that have everything loaded when they begin."""

import json
import os
import signal
import subprocess
import sys
import threading
from functools import cached_property
from pathlib import Path

PATIENCE_S = 90.0

FORKING = """
# FIRST
import gc, importlib, json, os, sys
import boto3, drcli.rewards.check, drcli.run.plan, drcli.bucket.connect, drcli.checks.validate
from drcli.cli.app import main
from drcli.cli.command_line import load
from drcli.cli.command_table import COMMANDS

for command in COMMANDS:
    load(command)
# THEN
gc.freeze()
for line in sys.stdin:
    call = json.loads(line)
    for name in call["modules"]:
        if name not in sys.modules:
            importlib.import_module(name)
            gc.freeze()
    pid = os.fork()
    if pid == 0:
        os.chdir(call["folder"])
        os.environ.clear()
        os.environ.update(call["environment"])
        for stream, path in enumerate((os.devnull, *call["said"])):
            os.dup2(os.open(path, os.O_RDWR | os.O_CREAT, 0o600), stream)
        try:
            main(call["arguments"])
        except SystemExit as end:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end.code)  # to take everything down that was loaded would take long as well
    print(pid, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""
"""Runs each command line in a process of its own that has everything loaded when it begins."""

FORMATS = ("torch", "drcli.convert.engines")
REPORTS = ("drcli.analysis.analysis", "drcli.analysis.outputs", "matplotlib.figure", "pandas")
MODULES = {
    "analyze": REPORTS,
    "start-loganalysis": REPORTS,
    "saliency": ("torch", "drcli.view.saliency.explain_model", "drsim.episode.simulation"),
    "export": FORMATS,
    "import": FORMATS,
    "upload-car-zip": FORMATS,
}
"""What else the first of these commands loads, for those that follow."""


class Forks:
    """Runs commands as `dr` does, without the loading that takes most of a short command's time.

    They run one after the other, whoever asks.

    Args:
        folder: For what the commands say.
        first: Python code that runs before anything of ours is loaded.
        then: Python code that runs when everything is loaded.
        patience_s: A command that takes longer is killed; its exit code is -9.
    """

    def __init__(
        self, folder: Path, *, first: str = "", then: str = "", patience_s: float = PATIENCE_S
    ) -> None:
        self._folder = folder
        self._code = FORKING.replace("# FIRST", first).replace("# THEN", then)
        self._patience_s = patience_s
        self._lock = threading.Lock()

    @cached_property
    def _process(self) -> "subprocess.Popen[str]":
        return subprocess.Popen(
            [sys.executable, "-c", self._code],
            cwd=self._folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(
        self, arguments: list[str], folder: Path, environment: dict[str, str]
    ) -> "subprocess.CompletedProcess[str]":
        """What a command answered in a folder."""
        said = (self._folder / "out", self._folder / "err")
        call = {"arguments": arguments, "folder": str(folder), "environment": environment}
        modules = MODULES.get(arguments[0], ()) if arguments else ()
        with self._lock:
            for path in said:
                path.unlink(missing_ok=True)
            asked, answered = self._process.stdin, self._process.stdout
            assert asked is not None
            assert answered is not None
            more = {"said": [str(path) for path in said], "modules": modules}
            asked.write(json.dumps({**call, **more}) + "\n")
            asked.flush()
            pid = int(answered.readline())
            ending = threading.Timer(self._patience_s, os.kill, (pid, signal.SIGKILL))
            ending.start()
            code = int(answered.readline())
            ending.cancel()
            out, err = (path.read_text("utf-8", "backslashreplace") for path in said)
        return subprocess.CompletedProcess(arguments, code, out, err)

    def close(self) -> None:
        if "_process" in vars(self):
            self._process.communicate(timeout=self._patience_s)
