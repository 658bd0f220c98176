"""A page that needs no network, with its sections and scripts."""

import base64
import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from drcli import __version__
from drcli.analysis.report.graphs import Section
from drcli.analysis.report.joined_script import joined_script, page_file
from drcli.analysis.report.markup import Content, Html, element, joined, json_text

_SCRIPTS = ("theme.js", "vendor/uplot/uPlot.iife.min.js")
_STYLES = ("vendor/uplot/uPlot.min.css", "colors.css", "parts.css", "page.css")


def html_document(
    title: str,
    below_title: Sequence[Content],
    overview: Content,
    sections: Sequence[Section],
    drawn: dict[str, Any] | None = None,
) -> str:
    """A page of sections; `drawn` are the numbers of the map."""
    graphs = {graph.key: graph.as_data() for section in sections for graph in section.graphs}
    theme = element("div", id="themes")
    name = element("div", element("h1", title), *below_title)
    contents = [
        element("li", element("a", section.short, href=f"#{section.key}")) for section in sections
    ]
    what = "Graphs need" if drawn is None else "Graphs and the map need"
    without = element("p", f"{what} JavaScript; texts and tables do not.")
    body = [
        element("header", element("div", name, theme, class_="top"), overview),
        element("nav", element("ul", *contents), aria_label="Sections"),
        element(
            "main",
            element("noscript", without),
            *(section.as_html() for section in sections),
        ),
        element("footer", element("p", _made())),
    ]
    return _whole(title, joined(body), json_text({"graphs": graphs, "map": drawn}))


def _made() -> str:
    now = datetime.now(UTC)
    return f"Made by drcli {__version__} on {now:%Y-%m-%d} at {now:%H:%M} UTC."


def _whole(title: str, body: Html, data: str) -> str:
    """The page around its content.

    Only our own scripts and styles, known by their hashes, may run: not even unescaped text does
    harm.
    """
    styles = [page_file(name) for name in _STYLES]
    scripts = [*(page_file(name) for name in _SCRIPTS), joined_script("/report.js")]
    policy = (
        f"default-src 'none'; img-src data:; script-src {_hashes(scripts)}; "
        f"style-src {_hashes(styles)}; base-uri 'none'; form-action 'none'"
    )
    head = [
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="referrer", content="no-referrer"),
        element("meta", name="generator", content=f"drcli {__version__}"),
        element("title", title),
        Html('<link rel="icon" href="data:,">'),
        *(element("style", Html(style)) for style in styles),
        element("script", Html(scripts[0])),  # dark or light, before anything is seen
    ]
    tail = [
        Html(f'<script type="application/json" id="data">{data}</script>'),
        *(element("script", Html(script)) for script in scripts[1:]),
    ]
    page = element("html", element("head", *head), element("body", body, *tail), lang="en")
    return f"<!doctype html>\n{page}\n"


def _hashes(texts: Sequence[str]) -> str:
    found = (hashlib.sha256(text.encode("utf-8")).digest() for text in texts)
    return " ".join(f"'sha256-{base64.b64encode(hash_).decode('ascii')}'" for hash_ in found)
