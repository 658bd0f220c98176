"""Log files of limited size.

`sim-0.log` is the current file, `sim-0.log.part-0001` an older part, `sim-0.log.20261122-093000` of
an earlier training. Only the current one ends in `.log`: log-guru fails at one that begins in the
middle. `sim-0.jsonl` has JSON lines, `reward-0.log` what the racer's code printed.
"""

import calendar
import os
import re
import time
from contextlib import suppress
from pathlib import Path

VARIABLE = "DRCLI_LOG"
UPLOADED = ".uploaded"
"""Says how much is in the bucket."""

SENT = ".sent"
"""For a service that collects logs."""

EARLIER_TRAININGS = 3
_STAMP = "%Y%m%d-%H%M%S"
_WORKER = r"(?:(?:trainer|supervisor|sim-\d+)\.(?:log|jsonl)|reward-\d+\.log)"
_LOG = re.compile(rf"({_WORKER})(\.part-\d+)?")
_EARLIER = re.compile(rf"{_WORKER}\.(\d{{8}}-\d{{6}})(?:\.part-\d+)?")


def part_bytes(max_bytes: int) -> int:
    """Half of the log: tools read a single file."""
    return max_bytes // 2


def older_parts(log: Path) -> list[Path]:
    parts = log.parent.glob(f"{log.name}.part-*")
    return sorted((path for path in parts if path.name.rpartition("-")[2].isdigit()), key=number_of)


def number_of(part: Path) -> int:
    """From 1."""
    return int(part.name.rpartition(".part-")[2])


def current_number(log: Path) -> int:
    parts = older_parts(log)
    return number_of(parts[-1]) + 1 if parts else 1


def rotate(log: Path, max_bytes: int) -> int:
    """Begin a new file; returns its descriptor in append mode.

    Raises:
        OSError: The log has not changed.
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
    """Rename the logs of the last training.

    Earlier logs may have `max_bytes` for each worker; the newest stays.
    """
    stamp = _stamp(folders)
    for folder in folders:
        workers = set()
        for path in _files(folder):
            found = _LOG.fullmatch(path.name)
            if path.name.endswith((UPLOADED, SENT)):
                path.unlink()
            elif found:
                workers.add(found[1])
                path.rename(path.with_name(f"{found[1]}.{stamp}{found[2] or ''}"))
        _delete_earliest(folder, max_bytes * max(1, len(workers)))


def _delete_earliest(folder: Path, max_bytes: int) -> None:
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
    """Still the newest if the clock was set back."""
    found = (_EARLIER.fullmatch(path.name) for folder in folders for path in _files(folder))
    newest = max((match[1] for match in found if match), default="")
    now = time.strftime(_STAMP, time.gmtime())
    if now > newest:
        return now
    try:
        return time.strftime(
            _STAMP, time.gmtime(calendar.timegm(time.strptime(newest, _STAMP)) + 1)
        )
    except ValueError:  # no time at all, such as the 99th month
        return now


def _files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _prune(parts: list[Path], max_bytes: int) -> None:
    """The newest gives the next one its number."""
    sizes = [path.stat().st_size for path in parts]
    while len(parts) > 1 and sum(sizes) > max_bytes:
        with suppress(OSError):
            parts[0].unlink()
        parts, sizes = parts[1:], sizes[1:]
