"""Explains an episode of a model, and writes the findings."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Annotated

import numpy as np
import torch

from drcli.base.errors import SettingsError
from drcli.base.files import make_picture_folder, rewrite
from drcli.base.report import Col, View, bold, counted, dim, table
from drcli.config.settings import Settings
from drcli.config.value_types import CheckpointChoice
from drcli.model import keys
from drcli.model.checkpoint_choice import take_choice
from drcli.model.model_store import ModelStore
from drcli.view.saliency.explained_episode import (
    COLUMNS,
    ROWS,
    ExplainedEpisode,
    RecordedEpisode,
    explain_episode,
    place_of,
    record_episode,
    shares,
    spread_steps,
)
from drcli.view.saliency.explanation_pictures import (
    decision,
    finding,
    lidar_finding,
    moment,
    pictures_of,
    still,
)
from drcli.view.saliency.policy_outputs import (
    ExplainedPolicy,
    Float64s,
    NotExplainable,
    action_table,
    open_policy,
    open_policy_file,
)
from drcli.view.saliency.saliency_options import SaliencyOptions
from drcli.view.video.overlay import encoded
from drcli.workers.cores import usable_cores

# SVG curves along an episode.


_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 960, 180, 80, 28
_MOST_POINTS = 600
_LEGEND = (
    "probability of each action: blue steers to the left, orange to the right, grey straight "
    "ahead; darker is slower"
)

_LEFT_HUE, _RIGHT_HUE = 210.0, 25.0
"""Blue and orange, for colour-blind people."""


def action_curves(explained: ExplainedEpisode) -> str:
    """Probabilities, or steering with its spread."""
    outputs, seconds = explained.outputs, _seconds(explained)
    if outputs.probabilities is not None:
        table = action_table(explained.subject.actions)
        order = sorted(range(len(table)), key=lambda index: (-table[index, 0], table[index, 1]))
        edges = np.cumsum(outputs.probabilities[:, order], axis=1)
        body, below = [], np.zeros(len(seconds))
        for place, index in enumerate(order):
            name = f"action {index}: {table[index, 0]:+g} degrees, {table[index, 1]:g} m/s"
            colour = action_colour(table, index)
            body.append(_area(seconds, below, edges[:, place], (0.0, 1.0), colour, name))
            below = edges[:, place]
        return _chart(explained, "".join(body), (0.0, 1.0), _LEGEND, "%")
    return _with_spread(explained, 0, "steering, degrees to the left")


def value_curve(explained: ExplainedEpisode) -> str:
    values = explained.outputs.value
    if values is None:
        return ""
    limits = _limits(values)
    line = _line(_seconds(explained), values, limits, "#7a3db8", "expected reward")
    return _chart(explained, line, limits, "discounted reward that the critic expects", "")


def entropy_curve(explained: ExplainedEpisode) -> str:
    """Share of the greatest; empty without one."""
    outputs = explained.outputs
    if outputs.entropy is None or outputs.probabilities is None:
        return ""
    most = np.log(max(2, outputs.probabilities.shape[1]))
    line = _line(_seconds(explained), outputs.entropy / most, (0.0, 1.0), "#0f7b4f", "entropy")
    return _chart(explained, line, (0.0, 1.0), "entropy: 100 % is as undecided as possible", "%")


def action_colour(table: Float64s, index: int) -> str:
    steering, speed = table[index]
    most = max(float(np.abs(table[:, 0]).max()), 1e-9)
    fastest = max(float(table[:, 1].max()), 1e-9)
    hue = _LEFT_HUE if steering > 0 else _RIGHT_HUE
    strength = abs(steering) / most
    light = 38.0 + 32.0 * max(0.0, speed / fastest)
    return f"hsl({hue:g} {85 * strength:.0f}% {light:.0f}%)"


def _with_spread(explained: ExplainedEpisode, column: int, name: str) -> str:
    outputs, seconds = explained.outputs, _seconds(explained)
    values = outputs.speed_mps if column else outputs.steering_deg
    shown, body = [values], ""
    if outputs.low is not None and outputs.high is not None:
        low, high = outputs.low[:, column], outputs.high[:, column]
        shown += [low, high]
        limits = _limits(*shown)
        body = _area(seconds, low, high, limits, "hsl(210 60% 60% / .4)", "two thirds of draws")
    limits = _limits(*shown)
    body += _line(seconds, values, limits, "#1c6bbd", name)
    return _chart(explained, body, limits, name, "")


def _seconds(explained: ExplainedEpisode) -> Float64s:
    return np.array([row.time_s for row in explained.episode.rows])


def _limits(*curves: Float64s) -> tuple[float, float]:
    low = min(float(curve.min()) for curve in curves)
    high = max(float(curve.max()) for curve in curves)
    room = 0.05 * (high - low) or max(abs(high) * 0.05, 0.5)
    return low - room, high + room


def _chart(
    explained: ExplainedEpisode, body: str, limits: tuple[float, float], title: str, unit: str
) -> str:
    seconds = _seconds(explained)
    marks = "".join(
        f'<line x1="{x:.1f}" x2="{x:.1f}" y1="4" y2="{_HEIGHT}" class="mark"/>'
        f'<text x="{x:.1f}" y="{_HEIGHT + 21}" class="tick" text-anchor="middle">'
        f"{number + 1}</text>"
        for number, step in enumerate(explained.chosen)
        for x in [float(_x(seconds, seconds[step]))]
    )
    factor = 100.0 if unit == "%" else 1.0
    ticks = "".join(
        f'<text x="{_LEFT - 6}" y="{float(_y(value, limits)) + 4:.1f}" class="tick" '
        f'text-anchor="end">{value * factor:.3g}{" %" * (unit == "%")}</text>'
        for value in limits
    )
    return (
        f"<figure><figcaption>{escape(title)}</figcaption>"
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT + _BOTTOM}" role="img" aria-label="{escape(title)}">'
        f"{body}{marks}{ticks}</svg></figure>"
    )


def _area(
    seconds: Float64s,
    low: Float64s,
    high: Float64s,
    limits: tuple[float, float],
    colour: str,
    name: str,
) -> str:
    there = _points(seconds, high, limits)
    back = _points(seconds, low, limits)[::-1]
    return (
        f'<polygon points="{" ".join([*there, *back])}" fill="{colour}">'
        f"<title>{escape(name)}</title></polygon>"
    )


def _line(
    seconds: Float64s, values: Float64s, limits: tuple[float, float], colour: str, name: str
) -> str:
    points = " ".join(_points(seconds, values, limits))
    return (
        f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2">'
        f"<title>{escape(name)}</title></polyline>"
    )


def _points(seconds: Float64s, values: Float64s, limits: tuple[float, float]) -> Sequence[str]:
    every = max(1, -(-len(seconds) // _MOST_POINTS))
    xs, ys = _x(seconds, seconds[::every]), _y(values[::every], limits)
    return [f"{x:.1f},{y:.1f}" for x, y in zip(xs.tolist(), ys.tolist(), strict=True)]


def _x(seconds: Float64s, at: Float64s) -> Float64s:
    span = max(float(seconds[-1] - seconds[0]), 1e-9)
    places: Float64s = _LEFT + (at - seconds[0]) / span * (_WIDTH - _LEFT - 12)
    return places


def _y(values: Float64s | float, limits: tuple[float, float]) -> Float64s:
    low, high = limits
    share = (np.asarray(values, np.float64) - low) / (high - low)
    places: Float64s = 6.0 + (1.0 - share) * (_HEIGHT - 12.0)
    return places


# An explained episode as HTML.


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
    speed = _with_spread(explained, 1, "requested speed, m/s")
    ended = f"{episode.outcome} after {episode.last.time_s:.1f} s, {episode.last.progress:.1f} %"
    notes = "".join(f"<p>{escape(note)}</p>" for note in explained.notes)
    steps = "".join(_step(explained, number) for number in range(len(explained.chosen)))
    return (
        f'<section class="saliency"><p>The most likely action is driven at every step. {ended} of '
        f"the lap. The numbers below the curves are those of the pictures.</p>{notes}"
        f"<h2>Along the lap</h2>{action_curves(explained)}{speed}"
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
        f'{b64encode(encoded(picture, "JPEG")).decode()}"><figcaption>{escape(title)}</figcaption>'
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


@dataclass(frozen=True)
class ExplainedStep:
    """What was found about one picture."""

    step: Annotated[int, "Its number in a trace.", Col("step")]
    time_s: Annotated[float, "Simulated seconds since the start."]
    progress: Annotated[float, "Percent of the lap.", Col("lap", "{:.1f} %")]
    x: Annotated[float, "Where the car was, metres."]
    y: Annotated[float, "The same."]
    action: Annotated[
        int | None, "Index of the most likely action, null for continuous ones.", Col("action")
    ]
    steering_deg: Annotated[float, "Requested, left positive.", Col("steering", "{:+.1f}°")]
    speed_mps: Annotated[float, "Requested.", Col("speed", "{:.2f} m/s")]
    strongest: Annotated[
        dict[str, tuple[int, int]], "For each method, row and column of the map's greatest value."
    ]
    greatest: Annotated[dict[str, float], "For each method, this value."]
    ninths: Annotated[
        dict[str, list[list[float]]],
        "For each method, shares of the picture's ninths, from the top.",
        Col("looks at", of=lambda step: step.looks_at()[0], side="left"),
    ]
    lidar: Annotated[list[float] | None, "How much each sector of the lidar matters, or null."]
    picture: Annotated[str | None, "File with the maps, or null."]

    def looks_at(self) -> tuple[str, float]:
        """The picture's ninth that matters most, and its share."""
        bands = next(iter(self.ninths.values()))
        ninths = (
            (share, -row, -column)
            for row, band in enumerate(bands)
            for column, share in enumerate(band)
        )
        most, row, column = max(ninths)
        rows, columns = ("far", "middle", "near"), ("left", "centre", "right")
        return f"{rows[-row]} {columns[-column]}" if most > 0 else "nothing", most


@dataclass(frozen=True)
class SaliencyReport:
    """An explained episode in numbers."""

    model: Annotated[str, "Prefix of the model, or path of the file."]
    checkpoint: Annotated[str | None, "Name of the checkpoint; null for a file."]
    world: Annotated[str, "The track."]
    target: Annotated[str, "What the maps explain."]
    unit: Annotated[str, "What the perturbation map counts."]
    outcome: Annotated[str, "How the episode ended."]
    progress: Annotated[float, "Percent of the lap."]
    seconds: Annotated[float, "Simulated seconds."]
    html: Annotated[str | None, "File of the page, or null."]
    steps: Annotated[list[ExplainedStep], "The explained pictures."]
    lap: Annotated[
        dict[str, list[object]],
        "For all steps: step, time_s, progress, steering_deg, speed_mps, and value, "
        "entropy and probabilities where the policy has them.",
    ]
    notes: Annotated[list[str], "What a reader should know."] = field(default_factory=list)

    def view(self) -> View:
        number = "" if self.checkpoint is None else f", checkpoint {self.checkpoint}"
        lap = f"{self.outcome}, {self.progress:.1f} % in {self.seconds:.2f} s"
        share = Col("share", "{:.0%}", of=lambda step: step.looks_at()[1])
        order = ("step", "progress", "action", "steering_deg", "speed_mps", "ninths", share)
        written = [step.picture for step in self.steps if step.picture is not None]
        return [
            bold(f"{self.model}{number}"),
            dim(f"on {self.world}: {lap}"),
            table(self.steps, *order),
            self.html and ("Page: ", bold(self.html)),
            written and f"{counted(len(written), 'picture')}, the first is {written[0]}.",
        ]


def explain_checkpoint(
    settings: Settings,
    model: ModelStore,
    choice: CheckpointChoice,
    question: SaliencyOptions,
) -> tuple[ExplainedEpisode, str]:
    """Drive and explain an episode; also returns the checkpoint's name.

    Raises:
        SettingsError: The model, checkpoint, or what is asked is missing.
        StorageError: Damaged checkpoint, or unreadable bucket.
    """
    if not keys.is_valid_prefix(model.prefix):
        raise SettingsError(
            f"{model.prefix!r} is not the prefix of a model.",
            remedy="List the models with `dr-list-models`; a policy's file is named by --model.",
        )
    name = take_choice(ModelStore.of(settings.model, model.bucket, model.prefix), choice).name
    subject = open_policy(model, name)
    number = name.partition("_")[0]
    return _explain(f"{model.prefix}, checkpoint {number}", subject, settings, question), name


def explain_file(
    settings: Settings, path: Path, metadata: Path | None, question: SaliencyOptions
) -> ExplainedEpisode:
    """As `explain_checkpoint`, of a policy's file.

    Raises:
        SettingsError: It cannot be used, or lacks what is asked.
        NotAvailable: Its engine is not installed.
    """
    return _explain(path.name, open_policy_file(path, metadata), settings, question)


def write_page(path: Path, explained: ExplainedEpisode) -> None:
    """Callers check whether it may replace a file; raises SettingsError."""
    rewrite(path, page(explained).encode())


def write_stills(folder: Path, explained: ExplainedEpisode) -> list[str]:
    """Write a PNG per picture into a new or existing folder; raises SettingsError."""
    make_picture_folder(folder)
    written = []
    for number, step in enumerate(explained.chosen):
        path = folder / f"saliency-{explained.episode.rows[step].steps:04d}.png"
        rewrite(path, encoded(still(explained, number), "PNG"))
        written.append(str(path))
    return written


def report_of(
    explained: ExplainedEpisode,
    model: str,
    checkpoint: str | None,
    html: Path | None,
    pictures: Sequence[str],
) -> SaliencyReport:
    episode = explained.episode
    return SaliencyReport(
        model=model,
        checkpoint=checkpoint,
        world=episode.world,
        target=explained.saliency.target,
        unit=explained.saliency.unit,
        outcome=episode.outcome,
        progress=episode.last.progress,
        seconds=episode.last.time_s,
        html=None if html is None else str(html),
        steps=[
            _explained_step(explained, number, pictures[number] if pictures else None)
            for number in range(len(explained.chosen))
        ],
        lap=_lap(explained),
        notes=list(explained.notes),
    )


def _explain(
    title: str, subject: ExplainedPolicy, settings: Settings, question: SaliencyOptions
) -> ExplainedEpisode:
    threads = usable_cores(settings.run.train)
    torch.set_num_threads(1)  # as in an evaluation: more would round in another way
    episode = record_episode(subject, settings.run, seed=question.seed, threads=threads)
    torch.set_num_threads(threads)
    chosen = _chosen(episode, question)
    try:
        return explain_episode(
            title,
            subject,
            episode,
            chosen,
            methods=question.methods,
            target=question.target,
            spacing=question.spacing,
        )
    except NotExplainable as error:
        raise SettingsError(
            f"{title} cannot be explained: {error}",
            remedy="Choose another --target or --method; --target action with --method "
            "perturbation works for every policy.",
        ) from None


def _chosen(episode: RecordedEpisode, question: SaliencyOptions) -> list[int]:
    if not question.steps:
        return spread_steps(episode.steps, question.pictures)
    first, last = episode.rows[0].steps, episode.rows[-1].steps
    wrong = [step for step in question.steps if not first <= step <= last]
    if wrong:
        raise SettingsError(
            f"The episode has no step {wrong[0]}: {episode.outcome} after step {last}.",
            remedy=f"Choose steps from {first} to {last} with --steps, or another start.",
        )
    return sorted({step - first for step in question.steps})


def _explained_step(explained: ExplainedEpisode, number: int, picture: str | None) -> ExplainedStep:
    step = explained.chosen[number]
    row, outputs, saliency = explained.episode.rows[step], explained.outputs, explained.saliency
    maps = {method: values[number].max(axis=0) for method, values in saliency.maps.items()}
    return ExplainedStep(
        step=row.steps,
        time_s=round(row.time_s, 3),
        progress=round(row.progress, 3),
        x=round(row.x, 4),
        y=round(row.y, 4),
        action=None if outputs.chosen is None else int(outputs.chosen[step]),
        steering_deg=round(float(outputs.steering_deg[step]), 3),
        speed_mps=round(float(outputs.speed_mps[step]), 3),
        strongest={method: place_of(values) for method, values in maps.items()},
        greatest={method: _short(float(values.max())) for method, values in maps.items()},
        ninths={
            method: [[round(share, 4) for share in band] for band in shares(values)]
            for method, values in maps.items()
        },
        lidar=None
        if saliency.lidar is None
        else [_short(value) for value in saliency.lidar[number].tolist()],
        picture=picture,
    )


def _lap(explained: ExplainedEpisode) -> dict[str, list[object]]:
    rows, outputs = explained.episode.rows, explained.outputs
    columns: dict[str, list[object]] = {
        "step": [row.steps for row in rows],
        "time_s": [round(row.time_s, 3) for row in rows],
        "progress": [round(row.progress, 3) for row in rows],
        "steering_deg": np.round(outputs.steering_deg, 3).tolist(),
        "speed_mps": np.round(outputs.speed_mps, 3).tolist(),
    }
    if outputs.value is not None:
        columns["value"] = [_short(value) for value in outputs.value.tolist()]
    if outputs.entropy is not None:
        columns["entropy"] = np.round(outputs.entropy, 4).tolist()
    if outputs.probabilities is not None:
        columns["probabilities"] = np.round(outputs.probabilities, 4).tolist()
    return columns


def _short(value: float) -> float:
    return float(f"{value:.6g}")
