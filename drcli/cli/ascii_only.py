"""Replaces characters that a terminal lacks by similar ASCII ones."""

import codecs
import io

HANDLER = "drcli.cli.ascii_only"
_BRAILLE = range(0x2800, 0x2900)
_MOST_DOTS = 8

_SIGNS = {
    **dict(zip("→↗↑↖←↙↓↘", ">/^\\</v\\", strict=True)),
    **dict(zip("▁▂▃▄▅▆▇█", "_.:-=+*#", strict=True)),
    **dict(zip("·◦●•…–—‘’“”×−✓✗", ".oO*.--''\"\"x-vx", strict=True)),
    **dict.fromkeys("─━╌═", "-"),
    **dict.fromkeys("│┃║", "|"),
    **dict.fromkeys("┌┐└┘├┤┬┴┼╭╮╰╯", "+"),
}


def use(stream: io.TextIOWrapper) -> None:
    codecs.register_error(HANDLER, _handle)
    stream.reconfigure(errors=HANDLER)


def plain(letter: str) -> str:
    if ord(letter) in _BRAILLE:
        dots = (ord(letter) - _BRAILLE.start).bit_count()
        return "#" if dots > _MOST_DOTS // 2 else "."
    return _SIGNS.get(letter, "?")


def _handle(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    wanted = error.object[error.start : error.end]
    return "".join(map(plain, wanted)), error.end
