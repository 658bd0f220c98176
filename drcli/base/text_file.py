"""Bytes to text, for files that people edit: a byte order mark is fine, all but text is not."""

from drcli.base.errors import SettingsError


def decode(data: bytes, name: str, *, largest_bytes: int, kind: str, remedy: str) -> str:
    """The text of a small UTF-8 file.

    Args:
        data: Its content, with or without a byte order mark.
        name: What to call it in messages.
        largest_bytes: More than this is a mistake.
        kind: What it should be, for instance "settings file".
        remedy: What to do when it is something else.

    Raises:
        SettingsError: It is too large or no UTF-8; the sentence names the line.
    """
    if len(data) > largest_bytes:
        raise SettingsError(
            f"{name}: is {len(data):,} bytes long, which no {kind} is.", remedy=remedy
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        line = data[: e.start].count(b"\n") + 1
        raise SettingsError(
            f"{name} line {line}: holds byte 0x{data[e.start]:02x}, which is no UTF-8 text.",
            remedy=remedy,
        ) from e
