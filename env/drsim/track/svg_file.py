"""The first line drawn in an SVG file, as points along it."""

import itertools
import math
import re
from xml.etree import ElementTree

import numpy as np

from drsim.arrays import Floats
from drsim.errors import TrackError
from drsim.track.svg_path import FURTHEST, numbers, path_curves, straight

_SHAPES = {"path", "polyline", "polygon"}
_NOT_DRAWN = {"defs", "symbol", "clipPath", "mask", "marker", "pattern"}
"""Elements whose content is only drawn where something else refers to it."""

_MAX_CURVES = 10_000
"""Far more than anyone draws for a track."""

_STEPS_TO_MEASURE = 16
"""Chords that measure a curve well enough to choose how many it is drawn with."""

_TRANSFORM = re.compile(r"[\s,]*(\w+)\s*\(([^()]*)\)")


def read_line(text: str, chords: int) -> Floats:
    """Points along the first path, polyline or polygon of a drawing.

    Args:
        text: An SVG document. Entities of its own are refused: they can multiply without end.
        chords: About how many chords the whole line is to have; each curve has at least one.

    Returns:
        Points in the unit of the drawing, x to the right and y up, all finite. Shape (k, 2),
        k >= 2.

    Raises:
        TrackError: The text is not a drawing with such a line.
    """
    shape, matrix = _first_shape(_parsed(text))
    curves = _curves(shape) @ matrix[:, :2].T + matrix[:, 2]
    if not (np.abs(curves) <= FURTHEST).all():
        raise TrackError(f"the transforms lead beyond {FURTHEST:.0e}. Draw the line smaller.")
    points = _flattened(curves, chords)
    return points * [1.0, -1.0]  # SVG counts y downwards


def _parsed(text: str) -> ElementTree.Element:
    if "<!ENTITY" in text:
        raise TrackError("it defines entities, which are not supported. Save it as plain SVG.")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise TrackError(f"this is not an SVG drawing ({error}). Save it as plain SVG.") from None


def _first_shape(root: ElementTree.Element) -> tuple[ElementTree.Element, Floats]:
    """The first shape in the order of the document, and what its transforms amount to."""
    waiting = [(root, np.eye(3)[:2])]
    while waiting:
        element, outside = waiting.pop()
        tag = str(element.tag).rpartition("}")[2]
        if tag in _NOT_DRAWN:
            continue
        matrix = _combined(outside, element.get("transform", ""))
        if tag in _SHAPES:
            return element, matrix
        waiting.extend((child, matrix) for child in reversed(element))
    raise TrackError(
        "the drawing has no path, polyline or polygon. Draw the centre line as one path; turn "
        "other shapes into paths."
    )


def _combined(outside: Floats, transform: str) -> Floats:
    """A transform inside another one. Shape (2, 3)."""
    matrix, place = outside, 0
    while match := _TRANSFORM.match(transform, place):
        place = match.end()
        inner = _matrix(match[1], list(numbers(match[2])))
        shift = matrix[:, :2] @ inner[:, 2] + matrix[:, 2]
        matrix = np.column_stack([matrix[:, :2] @ inner[:, :2], shift])
        if not (np.abs(matrix) <= FURTHEST).all():
            raise TrackError(f"the transforms lead beyond {FURTHEST:.0e}. Draw the line smaller.")
    if transform[place:].strip(" \t\r\n,"):
        raise TrackError(f"transform '{transform[place:][:40]}' is not understood. Remove it.")
    return matrix


def _matrix(name: str, values: list[float]) -> Floats:
    match name, values:
        case "matrix", [a, b, c, d, e, f]:
            return np.array([[a, c, e], [b, d, f]])
        case "translate", [x, *rest] if len(rest) <= 1:
            return np.array([[1.0, 0.0, x], [0.0, 1.0, rest[0] if rest else 0.0]])
        case "scale", [x, *rest] if len(rest) <= 1:
            return np.array([[x, 0.0, 0.0], [0.0, rest[0] if rest else x, 0.0]])
        case "rotate", [degrees, *rest] if len(rest) in (0, 2):
            x, y = rest or (0.0, 0.0)
            c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
            return np.array([[c, -s, x - c * x + s * y], [s, c, y - s * x - c * y]])
    raise TrackError(
        f"transform '{name[:40]}' with {len(values)} numbers is not understood. Use translate, "
        "scale, rotate or matrix, or apply the transform to the path."
    )


def _curves(shape: ElementTree.Element) -> Floats:
    """The line as cubic Bezier curves, each starting where the last one ends. Shape (k, 4, 2)."""
    if str(shape.tag).endswith("path"):
        curves = path_curves(shape.get("d", ""))
    else:
        values = list(numbers(shape.get("points", "")))
        points = [complex(x, y) for x, y in zip(values[::2], values[1::2], strict=False)]
        if str(shape.tag).endswith("polygon"):
            points += points[:1]
        curves = [straight(*ends) for ends in itertools.pairwise(points)]
    if not curves:
        raise TrackError("the first path of the drawing is empty. Remove it.")
    if len(curves) > _MAX_CURVES:
        raise TrackError(
            f"the path has {len(curves)} nodes; {_MAX_CURVES} are enough. Simplify it."
        )
    flat = np.array(curves)
    return np.stack([flat.real, flat.imag], axis=2)


def _flattened(curves: Floats, chords: int) -> Floats:
    """Points along curves: more on the longer ones. Shape (k, 2)."""
    share = np.linspace(0.0, 1.0, _STEPS_TO_MEASURE + 1)
    rough = _on(curves, share)
    length = np.hypot(*np.moveaxis(np.diff(rough, axis=1), 2, 0)).sum(axis=1)
    whole = length.sum()
    if not whole > 0:
        raise TrackError("the first path of the drawing is a point. Remove it.")
    count = np.maximum(1, np.ceil(chords * length / whole)).astype(np.int64)
    pieces = [
        _on(curve[None], np.linspace(0.0, 1.0, steps + 1)[1:])[0]
        for curve, steps in zip(curves, count.tolist(), strict=True)
    ]
    return np.concatenate([curves[0, :1], *pieces])


def _on(curves: Floats, share: Floats) -> Floats:
    """Points at shares 0 .. 1 of curves. Shape (k, m, 2)."""
    t = share[:, None]
    weights = ((1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3)
    total: Floats = sum(
        (curves[:, None, j] * weight for j, weight in enumerate(weights)),
        start=np.zeros((len(curves), len(share), 2)),
    )
    return total
