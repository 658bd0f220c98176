"""The section with pictures of what moves the policy's action."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field

from drcli.analysis.report.markup import Content, element
from drcli.analysis.report.section import Section
from drcli.analysis.report.words import digits

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
