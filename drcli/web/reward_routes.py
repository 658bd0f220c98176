"""The reward function on the page: text, templates, check."""

import ast
import itertools
import json
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.routing import BaseRoute, Route

from drcli.base.errors import WorkerDied
from drcli.base.installation import installation_error
from drcli.config.presets import model_file, preset_names, preset_of
from drcli.model.keys import REWARD_FUNCTION_FILE
from drcli.rewards.reward_parameter_texts import REWARD_PARAMETERS
from drcli.web.answers import BadRequest, Body, accepts, answers
from drcli.web.own_files import Save, own_file, save_own_file
from drcli.web.served_folder import ServedFolder

# Checks reward functions while they are typed: one at a time, only the newest of a page.


PATIENCE_S = 240.0
"""Includes compiling the simulation."""

COOL_DOWN_S = 0.4
"""Before a whole check, so that typing does not take a core from a training."""

IDLE_S = 600.0
MOST_WAITING = 8
MOST_PAGES = 64


class RewardChecks:
    """Uses one process. Any thread may call it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._numbers = itertools.count(1)
        self._newest: dict[str, int] = {}
        self._lock = threading.Lock()
        self._turns = threading.Condition()
        self._is_checking = False
        self._waiting = 0
        self._running: tuple[str, int] | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False
        self._ended_s = 0.0
        self._idle: threading.Timer | None = None

    def check(self, page: str, text: str, known: str, *, whole: bool = True) -> dict[str, Any]:
        """Check a reward function; waits for its turn.

        Args:
            page: Its earlier requests no longer count.
            text: The function.
            known: Key of the course that the page has.
            whole: Otherwise only its picture, which is soon there.

        Returns:
            A `LiveReport` or an error as JSON, or `{"superseded": true}`.

        Raises:
            BadRequest: Too many checks wait.
            WorkerDied: The process does not answer.
        """
        with self._turns:
            if self._waiting >= MOST_WAITING:
                raise BadRequest("Too many checks wait; try again in a moment.", 429)
            number = next(self._numbers)
            self._newest.pop(page, None)
            self._newest[page] = number
            while len(self._newest) > MOST_PAGES:
                del self._newest[next(iter(self._newest))]
            if self._running is not None and self._running[0] == page:
                with self._lock:
                    self._send({"cancel": self._running[1]})
            self._turns.notify_all()  # those that wait for an older text of the page end
            self._waiting += 1
            self._turns.wait_for(lambda: not self._is_checking or self._is_old(page, number))
            self._waiting -= 1
            if self._is_old(page, number):
                return {"superseded": True}
            self._is_checking = True
        try:
            with self._turns:
                wait_s = self._ended_s + COOL_DOWN_S - time.monotonic() if whole else 0.0
                if self._turns.wait_for(lambda: self._is_old(page, number), wait_s):
                    return {"superseded": True}
                self._running = (page, number)
            request = {"number": number, "text": text, "known": known, "whole": whole}
            return self._ask({**request, "folder": str(self._folder)})
        finally:
            self._ended_s = time.monotonic()
            with self._turns:
                self._running, self._is_checking = None, False
                self._turns.notify_all()

    def _is_old(self, page: str, number: int) -> bool:
        return self._newest.get(page) != number

    def close(self) -> None:
        """End the process; checks that still wait or come later start none."""
        self._closed = True
        self._end_process()

    def _end_process(self) -> None:
        if self._idle is not None:
            self._idle.cancel()
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    with suppress(OSError):
                        pipe.close()

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        process = self._started()
        late = threading.Timer(PATIENCE_S, process.kill)
        late.start()
        try:
            with self._lock:
                self._send(request)
            assert process.stdout is not None
            line = process.stdout.readline()
        finally:
            late.cancel()
        if not line:
            self._end_process()
            raise installation_error() or WorkerDied(
                "The check of the reward function did not end.",
                remedy="Change the function; then it is checked again.",
            )
        self._wait_idle()
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _started(self) -> subprocess.Popen[bytes]:
        if self._idle is not None:
            self._idle.cancel()
        if self._process is not None and self._process.poll() is None:
            return self._process
        self._end_process()
        with self._lock:  # `close` ends what is started before it, and nothing is started after
            if self._closed:
                raise WorkerDied("The console has ended.", remedy="Start it with `dr console`.")
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "drcli.web.reward_process"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            return self._process

    def _send(self, message: dict[str, Any]) -> None:
        process = self._process
        if process is not None and process.stdin is not None:
            with suppress(OSError, ValueError):  # its end is noticed by the reader
                process.stdin.write(json.dumps(message).encode() + b"\n")
                process.stdin.flush()

    def _wait_idle(self) -> None:
        self._idle = threading.Timer(IDLE_S, self._close_idle)
        self._idle.daemon = True
        self._idle.start()

    def _close_idle(self) -> None:
        with self._turns:
            if not self._is_checking:
                self._end_process()


def _templates() -> list[dict[str, str]]:
    top = model_file(REWARD_FUNCTION_FILE)
    paths = [("middle", top)]
    folder = model_file("rewards")
    paths += [(path.parent.name, path) for path in sorted(folder.glob(f"*/{top.name}"))]
    found = {name.replace("_", " "): path.read_text("utf-8") for name, path in paths}
    for name in preset_names():
        data = preset_of(name).files.get(top.name)
        text = "" if data is None else data.decode()
        if text and text not in found.values():
            found[name] = text
    return [{"name": name, "about": _about(text), "text": text} for name, text in found.items()]


def _about(text: str) -> str:
    tree = ast.parse(text)
    functions = [each for each in tree.body if isinstance(each, ast.FunctionDef)]
    documents = [ast.get_docstring(tree), *map(ast.get_docstring, reversed(functions))]
    return next((" ".join(each.split("\n\n")[0].split()) for each in documents if each), "")


class SaveReward(Save):
    text: str


class CheckReward(Body):
    page: str
    text: str
    known: str = ""
    whole: bool = True


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    checks = RewardChecks(folder.directory)
    folder.at_end.append(checks.close)

    def show(_: Request) -> Any:
        file = own_file(folder.settings(), REWARD_FUNCTION_FILE)
        return {**file.facts(), "text": file.text}

    def save(_: Request, body: SaveReward) -> Any:
        settings, text = folder.settings(), body.text.encode()
        return save_own_file(settings, REWARD_FUNCTION_FILE, text, body.version)

    def templates(_: Request) -> Any:
        parameters = [
            [name, text.kind, *(each.replace("**", "") for each in (text.unit, text.meaning))]
            for name, text in REWARD_PARAMETERS.items()
        ]
        return {"templates": _templates(), "parameters": parameters}

    def check(_: Request, body: CheckReward) -> Any:
        answer = checks.check(body.page[:64], body.text, body.known[:64], whole=body.whole)
        return JSONResponse(answer, 422 if "error" in answer else 200)

    return [
        Route("/api/reward", answers(show), methods=["GET"]),
        Route("/api/reward", accepts(save), methods=["PUT"]),
        Route("/api/reward/templates", answers(templates)),
        Route("/api/reward/check", accepts(check), methods=["POST"]),
    ]
