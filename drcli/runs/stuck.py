"""Explains a worker that the guard of the reward function has ended from outside Python.

It left no last words: it was inside one operation. The stacks of its threads are in its log.
"""

import re
import signal
from pathlib import Path

from drcli.errors import SettingsError
from drcli.job import LastWords
from drcli.store.keys import REWARD_FUNCTION_FILE

_TAIL_BYTES = 20_000
_THREAD = re.compile(r"^(?:Current thread|Thread) 0x", re.MULTILINE)
_PLACE = re.compile(rf'File "(.*{re.escape(REWARD_FUNCTION_FILE)})", line (\d+) in')


def words_of_stuck(code: int, log: Path) -> LastWords | None:
    """What a worker would have said, None where something else ended it.

    Args:
        code: How its process ended, as subprocess tells it.
        log: What it wrote.
    """
    if code != -getattr(signal, "SIGPROF", 0) or code == 0:
        return None
    path, line = _place(log)
    where = f" in {REWARD_FUNCTION_FILE}, line {line}," if line else ""
    return LastWords(
        f"Reward function error: The reward function{where} failed: one operation does not end, "
        f"and Python cannot interrupt it.{_quoted(path, line)}",
        f"Correct {REWARD_FUNCTION_FILE}, then go on with `dr-start-training --resume`, or start "
        "over with `-w`.",
        SettingsError.code,
        final=True,
    )


def _place(log: Path) -> tuple[Path | None, int]:
    """File and line of the reward function that the last stacks in a log show."""
    try:
        text = log.read_bytes()[-_TAIL_BYTES:].decode("utf-8", "replace")
    except OSError:
        return None, 0
    for stack in reversed(_THREAD.split(text)):
        found = _PLACE.search(stack)
        if found:
            return Path(found[1]), int(found[2])
    return None, 0


def _quoted(path: Path | None, line: int) -> str:
    try:
        lines = [] if path is None else path.read_text("utf-8", "replace").splitlines()
    except OSError:
        return ""
    return f"\n  {lines[line - 1].strip()}" if 0 < line <= len(lines) else ""
