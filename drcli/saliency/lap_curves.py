"""SVG curves along an episode."""

from collections.abc import Sequence
from html import escape

import numpy as np

from drcli.saliency.explained_episode import ExplainedEpisode
from drcli.saliency.policy_outputs import Float64s, action_table

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


def speed_curve(explained: ExplainedEpisode) -> str:
    return _with_spread(explained, 1, "requested speed, m/s")


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
