"""Descriptions of graphs, which the page draws with uPlot."""

import base64
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from drcli.analysis.report.markup import Content, Html, digits, element, nth, numbers

_FEW = 150
MOST_DOTS = 10_000
"""More cover each other, and take seconds to draw."""


@dataclass(frozen=True)
class Series:
    """One line, or dots.

    Attributes:
        x: Shape (n,).
        y: NaN where there is none. Shape (n,).
        color: Such as "c1" of colors.css.
        kind: "dots" are many small ones, "marks" few large ones.
        decimals: None: four significant digits.
        on: Until the reader switches it off.
    """

    name: str
    x: ArrayLike
    y: ArrayLike
    color: str
    kind: Literal["line", "dots", "marks"] = "line"
    axis: Literal["left", "right"] = "left"
    decimals: int | None = None
    on: bool = True


@dataclass(frozen=True)
class Mark:
    x: float
    label: str


@dataclass(frozen=True)
class Graph:
    """One graph.

    Attributes:
        whole_x: Whether positions are iterations.
        left_range: None: by the values.
        near: How far from the cursor a value is read out.
        height: Pixels.
    """

    key: str
    title: str
    x_label: str
    series: Sequence[Series]
    left: str
    right: str = ""
    marks: Sequence[Mark] = ()
    whole_x: bool = True
    x_decimals: int | None = None
    left_range: tuple[float, float] | None = None
    right_range: tuple[float, float] | None = None
    near: float = 0.5
    height: int = 320

    def as_data(self) -> dict[str, Any]:
        """Properties of the component that draws it, with its series packed."""
        axes = {"left": self.left, "right": self.right}
        limits = {"y": self.left_range, "right": self.right_range}
        return {
            "title": self.title,
            "x": "Iteration" if self.whole_x else self.x_label,
            "xDigits": self.x_decimals or 0,
            "axes": axes if self.whole_x else axes | {"x": self.x_label},
            "limits": {name: limit for name, limit in limits.items() if limit is not None},
            "marks": [asdict(mark) for mark in self.marks],
            "near": self.near,
            "height": self.height,
            "series": [_series_data(one) for one in self.series],
        }

    def as_html(self) -> Html:
        return element("div", data_graph=self.key, class_="graph")


def many_points(
    name: str,
    x: ArrayLike,
    y: ArrayLike,
    color: Literal["c1", "c2", "c3"],
    axis: Literal["left", "right"] = "left",
    decimals: int | None = None,
    *,
    on: bool = True,
    alone: bool = True,
) -> Series:
    """Points as small dots, or as larger ones where there are few and they are `alone`.

    Of more than `MOST_DOTS`, every n-th is drawn.
    """
    if alone and len(np.asarray(x)) <= _FEW:
        return Series(name, x, y, color, "marks", axis, decimals, on)
    every = dots_apart(len(np.asarray(x)))
    x, y = np.asarray(x)[::every], np.asarray(y)[::every]
    return Series(name, x, y, color.replace("c", "dots"), "dots", axis, decimals, on)


def dots_note(count: int, what: str) -> Html | None:
    """Which points are drawn; None if all are."""
    every = dots_apart(count)
    if every == 1:
        return None
    text = f"Every {nth(every)} {what} is a dot; lines and tables are of all."
    return element("p", text, class_="quiet")


def dots_apart(count: int) -> int:
    return max(1, math.ceil(count / MOST_DOTS))


_DOT_PX = {"dots": 4, "marks": 7}


def _series_data(series: Series) -> dict[str, Any]:
    looks = {
        "dots": _DOT_PX.get(series.kind),
        "axis": "right" if series.axis == "right" else None,
        "digits": series.decimals,
        "off": not series.on or None,
    }
    return {
        "name": series.name,
        "color": series.color,
        **{name: value for name, value in looks.items() if value is not None},
        "x": numbers(series.x),
        "y": numbers(series.y),
    }


# A section of the report.


@dataclass(frozen=True)
class Section:
    """One section.

    Attributes:
        key: Its address in the page.
        short: Its name in the contents.
        look: What to look for, or empty.
    """

    key: str
    title: str
    short: str
    look: str
    content: tuple[Content, ...]
    graphs: tuple[Graph, ...] = ()

    def as_html(self) -> Html:
        look = element("p", self.look, class_="look") if self.look else None
        heading = element("h2", self.title, id=f"{self.key}-title")
        return element(
            "section",
            heading,
            look,
            *self.content,
            id=self.key,
            aria_labelledby=f"{self.key}-title",
        )


# The section with pictures of what moves the policy's action.


_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class Picture:
    """A PNG picture, with numbers such as probabilities."""

    png: bytes
    caption: str
    numbers: dict[str, float] = field(default_factory=dict)


def picture_section(pictures: Sequence[Picture]) -> Section | None:
    """What is not a PNG file is left out."""
    found = [picture for picture in pictures if picture.png.startswith(_PNG)]
    if not found:
        return None
    look = (
        "Look at whether the bright places lie on the lines and the road ahead: a policy that "
        "looks at walls or the sky will fail elsewhere."
    )
    figures = [_figure(picture) for picture in found]
    content = (element("div", *figures, class_="pictures"),)
    return Section("explained", "What moves the action", "Explained", look, content)


def _figure(picture: Picture) -> Content:
    source = "data:image/png;base64," + base64.b64encode(picture.png).decode("ascii")
    numbers = ", ".join(f"{name}: {digits(value)}" for name, value in picture.numbers.items())
    return element(
        "figure",
        element("img", src=source, alt=picture.caption, loading="lazy"),
        element("figcaption", picture.caption),
        element("p", numbers) if numbers else None,
    )
