"""Log files that do not grow without end: a current file, older parts, logs of earlier trainings.

`sim-0.log` is the file that is written now, `sim-0.log.part-0001` an older part of the same log,
and `sim-0.log.20261122-093000` the log of an earlier training. Only the current file ends in
`.log`: log-guru imports every file that does, and stops at one that begins in the middle.
"""

import os
import re
import time
from contextlib import suppress
from pathlib import Path

VARIABLE = "DRCLI_LOG"
"""Environment variable that tells a process which log file its output goes to."""

UPLOADED = ".uploaded"
"""Ends the name of the note about how much of a log is in the bucket."""

EARLIER_TRAININGS = 3
"""The logs of so many earlier trainings are kept."""

_WORKER = r"(?:trainer|supervisor|sim-\d+)\.log"
_LOG = re.compile(rf"({_WORKER})(\.part-\d+)?")
_EARLIER = re.compile(rf"{_WORKER}\.(\d{{8}}-\d{{6}})(?:\.part-\d+)?")


def part_bytes(max_bytes: int) -> int:
    """How large the current file may become where a whole log may have so many bytes.

    Half of it: a large file keeps most trainings whole for tools that read a single one.
    """
    return max_bytes // 2


def older_parts(log: Path) -> list[Path]:
    """The older parts of a log, oldest first; the current file is not among them."""
    return sorted(
        (path for path in log.parent.glob(f"{log.name}.part-*") if _suffix(path).isdigit()),
        key=number_of,
    )


def number_of(part: Path) -> int:
    """The number of an older part; they count from 1."""
    return int(_suffix(part))


def current_number(log: Path) -> int:
    """The number that the current file gets once it becomes an older part."""
    parts = older_parts(log)
    return number_of(parts[-1]) + 1 if parts else 1


def rotate(log: Path, max_bytes: int) -> int:
    """Begin a new current file and delete the oldest parts while there is too much.

    Args:
        log: The current file, which becomes the newest of the older parts.
        max_bytes: How large current file and older parts may become together.

    Returns:
        A descriptor of the new file, which appends.

    Raises:
        OSError: The disk is full, or the folder is gone; the log is as it was.
    """
    fresh = log.with_name(f"{log.name}.new")
    descriptor = os.open(fresh, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_TRUNC, 0o666)
    try:
        log.rename(log.with_name(f"{log.name}.part-{current_number(log):04d}"))
        fresh.rename(log)
    except OSError:
        os.close(descriptor)
        raise
    _prune(older_parts(log), max_bytes - part_bytes(max_bytes))
    return descriptor


def set_aside(folders: list[Path], max_bytes: int) -> None:
    """Let a training that starts anew begin new log files, and keep those of the last few.

    Args:
        folders: Those in which the logs of the model's training lie.
        max_bytes: How large the logs of one worker may become together. The earlier ones in a
            folder may have as much for each worker; the newest of them stays in any case.
    """
    stamp = _stamp(folders)
    for folder in folders:
        workers = set()
        for path in _files(folder):
            found = _LOG.fullmatch(path.name)
            if path.name.endswith(UPLOADED):
                path.unlink()
            elif found:
                workers.add(found[1])
                path.rename(path.with_name(f"{found[1]}.{stamp}{found[2] or ''}"))
        _forget_earlier(folder, max_bytes * max(1, len(workers)))


def _forget_earlier(folder: Path, max_bytes: int) -> None:
    """Delete logs of the oldest trainings where there are too many, or too large ones."""
    by_stamp: dict[str, list[Path]] = {}
    for path in _files(folder):
        found = _EARLIER.fullmatch(path.name)
        if found:
            by_stamp.setdefault(found[1], []).append(path)
    kept_bytes = 0
    for index, stamp in enumerate(sorted(by_stamp, reverse=True)):
        kept_bytes += sum(path.stat().st_size for path in by_stamp[stamp])
        if index and (index >= EARLIER_TRAININGS or kept_bytes > max_bytes):
            for path in by_stamp[stamp]:
                path.unlink(missing_ok=True)


def _stamp(folders: list[Path]) -> str:
    """When a training is set aside, in UTC; a moment later where another one was in that second."""
    found = (_EARLIER.fullmatch(path.name) for folder in folders for path in _files(folder))
    newest = max((match[1] for match in found if match), default="")
    now = int(time.time())
    stamps = [_utc(now + later_s) for later_s in range(60)]
    return next((stamp for stamp in stamps if stamp > newest), stamps[0])


def _utc(seconds: int) -> str:
    return time.strftime("%Y%m%d-%H%M%S", time.gmtime(seconds))


def _files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _prune(parts: list[Path], max_bytes: int) -> None:
    """Delete the oldest parts; the newest stays, because the next one's number follows from it."""
    sizes = [path.stat().st_size for path in parts]
    while len(parts) > 1 and sum(sizes) > max_bytes:
        with suppress(OSError):
            parts[0].unlink()
        parts, sizes = parts[1:], sizes[1:]


def _suffix(part: Path) -> str:
    return part.name.rpartition(".part-")[2]
