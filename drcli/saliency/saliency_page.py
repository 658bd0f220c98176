"""An explained episode as HTML."""

from base64 import b64encode
from html import escape

import numpy as np

from drcli.saliency.explained_episode import (
    COLUMNS,
    ROWS,
    ExplainedEpisode,
    shares,
)
from drcli.saliency.explanation_pictures import (
    decision,
    finding,
    jpeg_bytes,
    lidar_finding,
    moment,
    pictures_of,
)
from drcli.saliency.lap_curves import (
    action_colour,
    action_curves,
    entropy_curve,
    speed_curve,
    value_curve,
)
from drcli.saliency.policy_outputs import action_table

_TARGETS = {
    "action": "the chosen action",
    "steering": "the steering",
    "speed": "the requested speed",
    "value": "what the critic expects",
}

STYLE = """
.saliency figure{margin:0 0 1rem}.saliency svg{width:100%;height:auto;background:var(--card)}
.saliency figcaption{font-weight:600;margin:.2rem 0}
.saliency .mark{stroke:currentColor;stroke-opacity:.45;stroke-dasharray:2 3}
.saliency .tick{font:12px system-ui,sans-serif;fill:currentColor}
@media(max-width:600px){.saliency .tick{font-size:26px}}
.saliency .step{border-top:1px solid var(--line);padding:.8rem 0;break-inside:avoid}
.saliency .views{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:.5rem}
.saliency .views figure{margin:0}.saliency .views img{width:100%;display:block}
.saliency .views figcaption{font-size:.85rem;font-weight:400}
.saliency .bars{display:grid;grid-template-columns:auto 1fr auto;gap:.1rem .5rem;font-size:.85rem;
align-items:center;margin-top:.4rem;max-width:40rem}
.saliency .bar{height:.7rem;background:var(--line)}.saliency .bar i{display:block;height:100%}
.saliency table{border-collapse:collapse}
.saliency td,.saliency th{padding:.3rem .7rem;border:1px solid var(--line)}
"""
"""A page with a section defines `--card` and `--line`."""

_PAGE_STYLE = """
:root{color-scheme:light dark;--card:#fff;--line:#c9ced6}
@media (prefers-color-scheme:dark){:root{--card:#1b1f26;--line:#4a515c}}
body{font:16px/1.5 system-ui,sans-serif;max-width:75rem;margin:0 auto;padding:1rem;
background:light-dark(#f5f6f8,#12151a);color:light-dark(#1d2229,#e6e9ee)}
h1{font-size:1.4rem;overflow-wrap:anywhere}h2{font-size:1.15rem}h3{font-size:1rem;margin:.2rem 0}
"""

_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""Against what names may contain."""


def page(explained: ExplainedEpisode) -> str:
    title = f"What moves the car: {explained.title} on {explained.episode.world}"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_PAGE_STYLE}{STYLE}</style></head><body>"
        f"<h1>{escape(title)}</h1>{section(explained)}</body></html>\n"
    )


def section(explained: ExplainedEpisode) -> str:
    episode = explained.episode
    ended = f"{episode.outcome} after {episode.last.time_s:.1f} s, {episode.last.progress:.1f} %"
    notes = "".join(f"<p>{escape(note)}</p>" for note in explained.notes)
    steps = "".join(_step(explained, number) for number in range(len(explained.chosen)))
    return (
        f'<section class="saliency"><p>The most likely action is driven at every step. {ended} of '
        f"the lap. The numbers below the curves are those of the pictures.</p>{notes}"
        f"<h2>Along the lap</h2>{action_curves(explained)}{speed_curve(explained)}"
        f"{entropy_curve(explained)}{value_curve(explained)}"
        f"<h2>Which pixels move {_TARGETS[explained.saliency.target]}</h2>{_how_to_read(explained)}"
        f"{_summary(explained)}{steps}</section>"
    )


def _how_to_read(explained: ExplainedEpisode) -> str:
    texts = {
        "perturbation": "<b>Perturbation</b>: bright where blurring the picture changes "
        f"{_TARGETS[explained.saliency.target]} most. It is measured, so trust it first.",
        "hires-cam": "<b>HiResCAM</b>: bright where the network found its evidence.",
        "grad-cam": "<b>Grad-CAM</b>: the better known but coarser form of it, which may light up "
        "places that do not matter to these networks.",
    }
    shown = "<br>".join(texts[method] for method in explained.saliency.maps)
    return (
        f"<p>{shown}</p><p>Look for the lines of the road and what lies ahead. If walls, sky or "
        "shadows are bright, the car steers by what another track does not have.</p>"
    )


def _summary(explained: ExplainedEpisode) -> str:
    saliency = explained.saliency
    method, maps = next(iter(saliency.maps.items()))
    ninths = np.mean([shares(values.max(axis=0)) for values in maps], axis=0)
    head = "".join(f'<th scope="col">{name}</th>' for name in COLUMNS)
    rows = "".join(
        f'<tr><th scope="row">{name}</th>{"".join(f"<td>{share:.0%}</td>" for share in row)}</tr>'
        for name, row in zip(ROWS, ninths, strict=True)
    )
    return (
        f"<h3>Where it looks, on average of these pictures ({escape(method)})</h3>"
        f"<table><tr><td></td>{head}</tr>{rows}</table>"
    )


def _step(explained: ExplainedEpisode, number: int) -> str:
    views = "".join(
        f'<figure><img alt="{escape(title)}, picture {number + 1}" src="data:image/jpeg;base64,'
        f'{b64encode(jpeg_bytes(picture)).decode()}"><figcaption>{escape(title)}</figcaption>'
        "</figure>"
        for title, picture in pictures_of(explained, number).items()
    )
    lidar = f"<p>{escape(found)}</p>" if (found := lidar_finding(explained, number)) else ""
    return (
        f'<div class="step"><h3>{number + 1}. {escape(moment(explained, number))}</h3>'
        f"<p>{escape(decision(explained, number))} {escape(finding(explained, number))}</p>"
        f'<div class="views">{views}</div>{_bars(explained, number)}'
        f"{lidar}</div>"
    )


def _bars(explained: ExplainedEpisode, number: int) -> str:
    probabilities = explained.saliency.outputs.probabilities
    if probabilities is None:
        return ""
    table = action_table(explained.subject.actions)
    order = sorted(range(len(table)), key=lambda index: (-table[index, 0], table[index, 1]))
    rows = "".join(
        f"<span>{index}: {table[index, 0]:+g}°, {table[index, 1]:g} m/s</span>"
        f'<span class="bar"><i style="width:{100 * share:.1f}%;'
        f'background:{action_colour(table, index)}"></i></span><span>{share:.1%}</span>'
        for index in order
        for share in [float(probabilities[number, index])]
    )
    return f'<div class="bars">{rows}</div>'
