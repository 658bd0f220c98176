"""Decodes files that people edit: UTF-8, with or without a byte order mark."""

from drcli.base.problems import Problem, ProblemsError


def decode(data: bytes, name: str, rule: str, *, largest_bytes: int, remedy: str) -> str:
    """ProblemsError if it is too large, or not UTF-8."""
    if len(data) > largest_bytes:
        size = f"{len(data):,} bytes long; at most {largest_bytes:,} are allowed."
        what = f"The file is {size}"
        raise ProblemsError([Problem(rule, "error", name, None, what, remedy)])
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        line = data[: e.start].count(b"\n") + 1
        what = f"Byte 0x{data[e.start]:02x} is not UTF-8 text."
        raise ProblemsError([Problem(rule, "error", name, line, what, remedy)]) from e
