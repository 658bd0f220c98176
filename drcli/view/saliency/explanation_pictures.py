"""Pictures of an explained episode, with maps."""

from collections.abc import Mapping

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from drcli.view.saliency.explained_episode import (
    COLUMNS,
    ROWS,
    ExplainedEpisode,
    sector_bearings,
    shares,
)
from drcli.view.saliency.policy_outputs import Float32s
from drcli.view.saliency.saliency_options import Method
from drsim.arrays import Bytes

# Draws a saliency map over its picture.


_STOPS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
_COLOURS = np.array(
    [(70, 10, 105), (170, 30, 110), (225, 65, 60), (250, 140, 20), (255, 235, 90)], np.float32
)
"""Lightness rises, for colour-blind people."""

_STRONGEST = 0.8
LEAST_FULL = 1e-6
"""Below this, a map is only rounding."""


def full_of(maps: Float32s) -> float:
    """The value drawn as most in an episode.

    Exceeded in one picture of ten at most; single peaks would make all pictures pale.
    """
    if not maps.size:
        return 0.0
    return float(np.quantile(maps.reshape(len(maps), -1).max(axis=1), 0.9))


def overlay(frame: Bytes, values: Float32s, full: float | None = None) -> Bytes:
    """A map over a grey or RGB picture, as RGB; `full` (None: the maximum) is drawn as most."""
    full = float(values.max(initial=0.0)) if full is None else full
    ground = frame[..., None].repeat(3, axis=2) if frame.ndim == 2 else frame
    if not full > LEAST_FULL:
        return ground.copy()
    share = np.clip(values / full, 0.0, 1.0)
    colour = np.stack([np.interp(share, _STOPS, band) for band in _COLOURS.T], axis=-1)
    weight = (_STRONGEST * np.sqrt(share))[..., None]
    mixed = ground * (1.0 - weight) + colour * weight
    return np.asarray(np.rint(mixed), np.uint8)


TITLES: Mapping[Method, str] = {
    "perturbation": "Perturbation",
    "hires-cam": "HiResCAM",
    "grad-cam": "Grad-CAM",
}

_ZOOM = 3
_GAP, _CAPTION = 8, 46
_INK, _PAPER = (38, 42, 48), (255, 255, 255)


def pictures_of(explained: ExplainedEpisode, number: int) -> dict[str, Bytes]:
    """What the car saw at a step, and each map over it, by title.

    Newest frame of a stack; right camera below the left. A map has one scale in the episode, except
    Grad-CAM and HiResCAM, whose values have no comparable unit.

    Returns:
        RGB, each of shape (eyes * 120, 160, 3).
    """
    spec = explained.subject.policy.spec
    frame = explained.episode.frames[explained.chosen[number]][-spec.eyes :]
    found = {"Camera": np.concatenate(frame)[..., None].repeat(3, axis=2)}
    for method, maps in explained.saliency.maps.items():
        full = full_of(maps) if method == "perturbation" else None
        found[TITLES[method]] = overlay(
            np.concatenate(frame), np.concatenate(maps[number]), full=full
        )
    return found


def still(explained: ExplainedEpisode, number: int) -> Bytes:
    """All pictures of a step, threefold, with a caption."""
    pictures = pictures_of(explained, number)
    height = next(iter(pictures.values())).shape[0] * _ZOOM
    width = 160 * _ZOOM
    lines = ["  ".join([moment(explained, number), decision(explained, number)])]
    lines += filter(None, [finding(explained, number), lidar_finding(explained, number)])
    size = len(pictures) * (width + _GAP) + _GAP, height + _CAPTION + 4 + 21 * len(lines)
    whole = Image.new("RGB", size, _PAPER)
    draw = ImageDraw.Draw(whole)
    font = ImageFont.load_default(18)
    for column, (title, picture) in enumerate(pictures.items()):
        left = _GAP + column * (width + _GAP)
        large = Image.fromarray(picture).resize((width, height), Image.Resampling.BICUBIC)
        whole.paste(large, (left, _CAPTION))
        draw.text((left, 14), title, _INK, font)
    for place, line in enumerate(lines):
        draw.text((_GAP, height + _CAPTION + 2 + 21 * place), line, _INK, font)
    return np.asarray(whole)


def moment(explained: ExplainedEpisode, number: int) -> str:
    row = explained.episode.rows[explained.chosen[number]]
    return f"Step {row.steps}, {row.time_s:.2f} s, {row.progress:.1f} % of the lap."


def decision(explained: ExplainedEpisode, number: int) -> str:
    outputs, step = explained.outputs, explained.chosen[number]
    steering, speed = outputs.steering_deg[step], outputs.speed_mps[step]
    text = f"{steering:+.1f} degrees, {speed:.2f} m/s"
    if outputs.probabilities is not None and outputs.chosen is not None:
        action = outputs.chosen[step]
        text = f"Action {action} ({text}) with {outputs.probabilities[step, action]:.0%}."
    elif outputs.low is not None and outputs.high is not None:
        spread = (outputs.high[step] - outputs.low[step]) / 2.0
        text += f" (training: ±{spread[0]:.1f} degrees, ±{spread[1]:.2f} m/s)."
    else:
        text += "."
    if outputs.value is not None:
        text += f" The critic expects {outputs.value[step] + 0.0:.4g}."  # + 0.0: never "-0"
    return text


def finding(explained: ExplainedEpisode, number: int) -> str:
    saliency = explained.saliency
    method, maps = next(iter(saliency.maps.items()))
    values = maps[number].max(axis=0)
    ninths = np.array(shares(values))
    row, column = np.unravel_index(int(ninths.argmax()), ninths.shape)
    if not ninths.any():
        return f"{TITLES[method]}: no part of the picture matters."
    where = f"{ninths.max():.0%} of it lies {ROWS[int(row)]} {COLUMNS[int(column)]}"
    if method != "perturbation":
        return f"{TITLES[method]}: {where}."
    most = quantity(float(values.max()), saliency.unit)
    limit = most if most.startswith("less") else f"at most {most}"
    return f"Blurring one place changes {limit}; {where}."


def lidar_finding(explained: ExplainedEpisode, number: int) -> str:
    lidar = explained.saliency.lidar
    if lidar is None:
        return ""
    values = lidar[number]
    most = int(values.argmax())
    if not values[most] > 0.0:
        return "Lidar: it meets nothing, or what it meets does not matter here."
    begin, end = sector_bearings(explained.subject)[most]
    text = quantity(float(values[most]), explained.saliency.unit)
    return (
        f"Lidar: the sector from {_bearing(begin)} to {_bearing(end)} matters most; without "
        f"what it meets, {text} would change."
    )


def quantity(value: float, unit: str) -> str:
    if unit.startswith("of the"):
        share = "less than 0.1%" if 0.0 < value < 0.0005 else f"{value:.1%}"
        return f"{share} {unit}"
    return f"{value:.3g} {unit}"


def _bearing(degrees: float) -> str:
    turned = (degrees + 180.0) % 360.0 - 180.0
    if abs(turned) < 0.5:
        return "straight ahead"
    return f"{abs(turned):.0f}° {'left' if turned > 0 else 'right'}"
