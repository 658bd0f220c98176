"""Decodes files that people edit: a byte order mark is fine, anything but UTF-8 text is not."""

from drcli.base.problems import Problem, ProblemsError


def decode(data: bytes, name: str, rule: str, *, largest_bytes: int, remedy: str) -> str:
    """The text of a small UTF-8 file.

    Args:
        data: Its content, with or without a byte order mark.
        name: What to call it in messages.
        rule: Number of the rule that is broken when it is something else.
        largest_bytes: A larger file was named by mistake.
        remedy: What to do then.

    Raises:
        ProblemsError: It is too large or is not UTF-8.
    """
    if len(data) > largest_bytes:
        what = f"is {len(data):,} bytes long; {largest_bytes:,} are allowed."
        raise ProblemsError([Problem(rule, "error", name, None, what, remedy)])
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        line = data[: e.start].count(b"\n") + 1
        what = f"byte 0x{data[e.start]:02x} is not UTF-8 text."
        raise ProblemsError([Problem(rule, "error", name, line, what, remedy)]) from e
