"""HTML that is safe by construction: all but `Html` is escaped."""

import base64
import html
import json
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any, SupportsFloat

import numpy as np
from numpy.typing import ArrayLike, NDArray

_UNSEEN = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""HTML forbids some control characters; others reverse the text after them."""

_VOID = ("img", "input", "meta", "rect")
_LONGEST_DIFFERENCE = 400


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


Content = str | Html | None


def escaped(text: str) -> Html:
    """As HTML, without control characters."""
    if isinstance(text, Html):
        return text
    return Html(html.escape(_UNSEEN.sub("\N{REPLACEMENT CHARACTER}", text)))


def joined(parts: Iterable[Content]) -> Html:
    return Html("".join(escaped(part) for part in parts if part is not None))


def element(name_: str, *content: Content, **attributes: str | bool | None) -> Html:
    """Such as `<td class="number">5</td>`; `class_` is written without its "_", others with "-".

    True stands for an attribute without a value; None and False are left out.
    """
    start = name_
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        start += " " + key.rstrip("_").replace("_", "-")
        if value is not True:
            start += f'="{escaped(value)}"'
    if name_ in _VOID:
        return Html(f"<{start}/>" if name_ == "rect" else f"<{start}>")
    return Html(f"<{start}>{joined(content)}</{name_}>")


def table(
    caption: str, head: Sequence[str], rows: Iterable[Sequence[Content]], *, texts: int = 1
) -> Html:
    """Scrollable on narrow screens; the first `texts` columns are text."""

    def cell(name: str, column: int, content: Content) -> Html:
        scope = {"th": "col", "td": None}[name]
        return element(name, content, class_=None if column < texts else "number", scope=scope)

    # A column of bars has no title: its cell is no heading.
    titles = element(
        "tr", *(cell("th" if title else "td", column, title) for column, title in enumerate(head))
    )
    lines = [
        element("tr", *(cell("td", column, content) for column, content in enumerate(row)))
        for row in rows
    ]
    return element(
        "div",
        element(
            "table",
            element("caption", caption),
            element("thead", titles),
            element("tbody", *lines),
        ),
        class_="scroll",
        tabindex="0",
        role="region",
        aria_label=caption,
    )


def bar(part: float, *, kind: str = "", title: str = "", alone: bool = False) -> Html:
    """As long as a part, 0 to 1, of its room."""
    width = f"{100 * min(max(part, 0.0), 1.0):.1f}%"
    return element(
        "svg",
        element("title", title) if title else None,
        element("rect", width="100%", height="100%", class_="room"),
        element("rect", width=width, height="100%", class_=f"part {kind}".strip()),
        class_="bar alone" if alone else "bar",
        role="img" if title else None,
        aria_hidden=None if title else "true",
    )


def tiles(facts: Iterable[tuple[str, str]]) -> Html:
    pairs = [element("div", element("dt", name), element("dd", value)) for name, value in facts]
    return element("dl", *pairs, class_="tiles")


def coloured_difference(lines: Sequence[str]) -> Html:
    """Lines of `diff -u`, without its head."""
    kinds = {"+": "added", "-": "removed", "@": "place"}
    parts: list[Content] = []
    for line in lines[:_LONGEST_DIFFERENCE]:
        kind = kinds.get(line[:1])
        parts += [element("span", line, class_=kind) if kind else line, "\n"]
    if len(lines) > _LONGEST_DIFFERENCE:
        parts.append(f"... {len(lines) - _LONGEST_DIFFERENCE} more lines")
    return element("pre", element("code", joined(parts)), class_="diff", tabindex="0")


# Numbers as people read them.


UNKNOWN = "\N{EN DASH}"


def count(value: SupportsFloat) -> str:
    """In groups of three digits."""
    number = float(value)
    return f"{number:,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}") if known(number) else UNKNOWN


def digits(value: SupportsFloat) -> str:
    number = float(value)
    if not known(number):
        return UNKNOWN
    size = abs(number)
    if size and (size >= 1e6 or size < 1e-3):
        return f"{number:.2e}"
    return f"{number:.4g}" if size < 1e4 else f"{number:.0f}"


def percent(value: SupportsFloat, digits: int = 1, sign: str = "\N{NO-BREAK SPACE}%") -> str:
    number = float(value)
    return f"{number:.{digits}f}{sign}" if known(number) else UNKNOWN


def seconds(value: SupportsFloat) -> str:
    number = float(value)
    return f"{number:.3f}" if known(number) else UNKNOWN


def nth(number: int) -> str:
    """`second`, `third`, `4th`."""
    return {2: "second", 3: "third"}.get(number, f"{number}th")


def known(value: float) -> bool:
    return math.isfinite(value)


# Numbers for the page: short lists as JSON, long ones as base64.


_SHORT = 64
_INTEGERS: dict[str, tuple[type[np.signedinteger[Any]], int]] = {
    "i8": (np.int8, 127),
    "i16": (np.int16, 32767),
}
"""Types and greatest values; one below the negative is NaN."""


def numbers(values: ArrayLike) -> object:
    """Values as a list, {"f32": base64} or what `quantised` returns."""
    array = np.asarray(values, dtype=np.float64)
    if len(array) <= _SHORT:
        return [float(f"{value:.6g}") if math.isfinite(value) else None for value in array.tolist()]
    if np.isfinite(array).all() and (array == np.rint(array)).all():
        for kind, (_, most) in _INTEGERS.items():
            if np.abs(array).max() <= most:
                return quantised(array, kind, low=-most, high=most)
    limit = float(np.finfo(np.float32).max)
    small = np.where(np.isfinite(array) & (np.abs(array) <= limit), array, np.nan)
    return {"f32": _base64(small.astype("<f4"))}


def quantised(values: ArrayLike, kind: str, *, low: float, high: float) -> object:
    """Integers of kind "i8" or "i16", cut to the limits; NaN stays NaN.

    Returns:
        {kind: base64, "middle": value of 0, "step": difference between two neighbours}.
    """
    array = np.asarray(values, dtype=np.float64)
    number, most = _INTEGERS[kind]
    middle = (low + high) / 2
    step = (high - low) / (2 * most) or 1.0
    integers = np.clip(np.rint((array - middle) / step), -most, most)
    integers = np.where(np.isnan(integers), -most - 1, integers)
    data = integers.astype(np.dtype(number).newbyteorder("<"))
    return {kind: _base64(data), "middle": middle, "step": step}


def json_text(value: object) -> str:
    """JSON that cannot end a script element."""
    text = json.dumps(_finite(value), separators=(",", ":"))
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def _base64(array: NDArray[Any]) -> str:
    return base64.b64encode(array.tobytes()).decode("ascii")


def _finite(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): _finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return value
