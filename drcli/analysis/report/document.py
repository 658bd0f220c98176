"""A page that needs no network, with its sections and scripts."""

import base64
import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.resources import files
from typing import Any

from drcli import __version__
from drcli.analysis.report.graphs import Section
from drcli.analysis.report.markup import Content, Html, element, joined, json_text

_SCRIPTS = (
    "uplot/uPlot.iife.min.js",
    "page.js",
    "graph_parts.js",
    "graphs.js",
    "map_parts.js",
    "track_map.js",
    "lap_player.js",
    "start.js",
)
_STYLES = ("uplot/uPlot.min.css", "colors.css", "page.css")


def html_document(
    title: str,
    below_title: Sequence[Content],
    overview: Content,
    sections: Sequence[Section],
    drawn: dict[str, Any] | None = None,
) -> str:
    """A page of sections; `drawn` are the numbers of the map."""
    graphs = {graph.key: graph.as_data() for section in sections for graph in section.graphs}
    theme = element("button", "Dark", type="button", id="theme", hidden=True)
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
    styles = [_asset(name) for name in _STYLES]
    library, *parts = (_asset(name).replace("\nexport ", "\n") for name in _SCRIPTS)
    own = '(() => {\n"use strict";\n' + "\n".join(parts) + "})();\n"
    scripts = [library, own]
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
    ]
    tail = [
        Html(f'<script type="application/json" id="data">{data}</script>'),
        *(element("script", Html(script)) for script in scripts),
    ]
    page = element("html", element("head", *head), element("body", body, *tail), lang="en")
    return f"<!doctype html>\n{page}\n"


def _asset(name: str) -> str:
    return files("drcli.analysis.report").joinpath("assets", *name.split("/")).read_text("utf-8")


def _hashes(texts: Sequence[str]) -> str:
    found = (hashlib.sha256(text.encode("utf-8")).digest() for text in texts)
    return " ".join(f"'sha256-{base64.b64encode(hash_).decode('ascii')}'" for hash_ in found)
