"""A section of the report."""

from dataclasses import dataclass

from drcli.analysis.report.graphs import Graph
from drcli.analysis.report.markup import Content, Html, element


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
