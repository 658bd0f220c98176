"""Explains why a worker ended whose reward function was stuck in one operation.

Python could not interrupt it; stacks are in its log.
"""

import re
import signal
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.exchange.job import WorkerExit
from drcli.store.keys import REWARD_FUNCTION_FILE

_WHY = "one operation takes far longer than a call may, and Python cannot interrupt it"
_REMEDY = "Correct reward_function.py, then continue with `dr-start-training --resume-or-start`."

_TAIL_BYTES = 20_000
_THREAD = re.compile(r"^(?:Current thread|Thread) 0x", re.MULTILINE)
_ESCAPED = re.compile(r"\\x([0-9a-f]{2})|\\u([0-9a-f]{4})|\\U([0-9a-f]{8})")
_PLACE = re.compile(rf'File "(.*{re.escape(REWARD_FUNCTION_FILE)})", line (\d+) in')


def is_stuck(code: int) -> bool:
    return code < 0 and -code == getattr(signal, "SIGPROF", None)


def stuck_place(text: str) -> tuple[Path | None, int]:
    for stack in reversed(_THREAD.split(text)):
        found = _PLACE.search(stack)
        if found:
            return Path(_ESCAPED.sub(_letter, found[1])), int(found[2])
    return None, 0


def _letter(escaped: re.Match[str]) -> str:
    """Python's fault handler writes only ASCII."""
    return chr(int(next(filter(None, escaped.groups())), 16))


def exit_of_stuck(code: int, log: Path, *, remedy: str = _REMEDY) -> WorkerExit | None:
    """The error of a stuck worker, or None."""
    if not is_stuck(code):
        return None
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - _TAIL_BYTES))
            text = file.read().decode("utf-8", "replace")
    except OSError:
        text = ""
    path, line = stuck_place(text)
    where = f" in {REWARD_FUNCTION_FILE}, line {line}," if line else ""
    what = f"Reward function error: The reward function{where} failed: {_WHY}."
    if source := source_line(path, line):
        what += f"\n  {source}"
    return WorkerExit(what, remedy, SettingsError.code, final=True)


def source_line(path: Path | None, line: int) -> str:
    try:
        lines = [] if path is None else path.read_text("utf-8", "replace").splitlines()
    except OSError:
        return ""
    return lines[line - 1].strip() if 0 < line <= len(lines) else ""
