"""Reads the end of a file as text."""

from pathlib import Path

_HEAD_SHARE = 16


def text_tail(path: Path, most_bytes: int) -> str:
    """Never a part of a line, which could be a part of a secret."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(0)
        if size <= most_bytes:
            return file.read(most_bytes).decode("utf-8", "replace")
        head = file.read(most_bytes // _HEAD_SHARE)
        head = head[: head.rfind(b"\n") + 1]
        file.seek(size - (most_bytes - len(head)))
        _, _, tail = file.read(most_bytes).partition(b"\n")
    left_out = size - len(head) - len(tail)
    note = f"(... {left_out:,} bytes were left out here ...)\n"
    return head.decode("utf-8", "replace") + note + tail.decode("utf-8", "replace")
