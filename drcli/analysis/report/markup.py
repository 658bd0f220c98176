"""HTML that is safe by construction: all but `Html` is escaped."""

import html
import re
from collections.abc import Iterable, Sequence

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
