"""The first line drawn in an SVG file, as points along it."""

import itertools
import math
import re
from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np

from drsim.arrays import Floats
from drsim.errors import TrackError

Curve = tuple[complex, complex, complex, complex]
"""A cubic Bezier curve: start, two control points, end, as x + y i."""

_FURTHEST = 1e9
"""Beyond, rounding would swallow the drawing."""

_NUMBER = re.compile(r"[\s,]*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")
_FLAG = re.compile(r"[\s,]*([01])")
_REST = re.compile(r"[\s,]*\Z")
_COMMAND = re.compile(r"([MLHVCSQTAZ])([^MLHVCSQTAZ]*)", re.IGNORECASE)
_KINDS = {
    "M": "nn",
    "L": "nn",
    "H": "n",
    "V": "n",
    "C": "nnnnnn",
    "S": "nnnn",
    "Q": "nnnn",
    "T": "nn",
    "A": "nnnffnn",
}
_SHAPES = {"path", "polyline", "polygon"}
_NOT_DRAWN = {"defs", "symbol", "clipPath", "mask", "marker", "pattern"}
_MAX_CURVES = 10_000
_STEPS_TO_MEASURE = 16
_TRANSFORM = re.compile(r"[\s,]*(\w+)\s*\(([^()]*)\)")


def read_line(text: str, chords: int) -> Floats:
    """Points along the first path, polyline or polygon of a drawing, about as many as `chords`.

    In the drawing's unit, y up. Entities are refused: they can multiply without end.

    Raises:
        TrackError: The text is not a drawing with such a line.
    """
    shape, matrix = _first_shape(_parsed(text))
    curves = _curves(shape) @ matrix[:, :2].T + matrix[:, 2]
    _check_reach(curves)
    return _flattened(curves, chords) * [1.0, -1.0]  # SVG counts y downwards


def _parsed(text: str) -> ElementTree.Element:
    if "<!ENTITY" in text:
        raise TrackError("it defines entities, which are not supported. Save it as plain SVG.")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise TrackError(f"this is not an SVG drawing ({error}). Save it as plain SVG.") from None


def _first_shape(root: ElementTree.Element) -> tuple[ElementTree.Element, Floats]:
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
    matrix, place = outside, 0
    while match := _TRANSFORM.match(transform, place):
        place = match.end()
        inner = _matrix(match[1], list(_numbers(match[2])))
        shift = matrix[:, :2] @ inner[:, 2] + matrix[:, 2]
        matrix = np.column_stack([matrix[:, :2] @ inner[:, :2], shift])
        _check_reach(matrix)
    if transform[place:].strip(" \t\r\n,"):
        raise TrackError(f"transform '{transform[place:][:40]}' is not supported. Remove it.")
    return matrix


def _check_reach(numbers: Floats) -> None:
    if not (np.abs(numbers) <= _FURTHEST).all():
        raise TrackError(
            f"with its transforms, the line is further than {_FURTHEST:.0e} from the "
            "origin. Make the drawing smaller."
        )


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
        f"transform '{name[:40]}' with {len(values)} numbers is not supported. Use translate, "
        "scale, rotate or matrix, or apply the transform to the path."
    )


def _curves(shape: ElementTree.Element) -> Floats:
    if str(shape.tag).endswith("path"):
        curves = _Pen().drawn(shape.get("d", ""))
    else:
        values = list(_numbers(shape.get("points", "")))
        points = [complex(x, y) for x, y in zip(values[::2], values[1::2], strict=False)]
        if str(shape.tag).endswith("polygon"):
            points += points[:1]
        curves = [_straight(*ends) for ends in itertools.pairwise(points)]
    if not curves:
        raise TrackError("the first path of the drawing is empty. Remove it.")
    if len(curves) > _MAX_CURVES:
        raise TrackError(
            f"the path has {len(curves)} nodes; {_MAX_CURVES} are enough. Simplify it."
        )
    flat = np.array(curves)
    return np.stack([flat.real, flat.imag], axis=2)


def _flattened(curves: Floats, chords: int) -> Floats:
    rough = _on(curves, np.linspace(0.0, 1.0, _STEPS_TO_MEASURE + 1))
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
    t = share[:, None]
    weights = ((1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3)
    return sum(
        (curves[:, None, j] * weight for j, weight in enumerate(weights)),
        start=np.zeros((len(curves), len(share), 2)),
    )


def _straight(start: complex, end: complex) -> Curve:
    return start, start + (end - start) / 3, end - (end - start) / 3, end


def _numbers(text: str) -> Iterator[float]:
    place = 0
    while not _REST.match(text, place):
        value, place = _value(text, place, "n")
        yield value


def _value(text: str, place: int, kind: str) -> tuple[float, int]:
    match = (_NUMBER if kind == "n" else _FLAG).match(text, place)
    value = float(match[1]) if match else math.inf
    if match is None or abs(value) > _FURTHEST:
        raise TrackError(
            f"'{text[place : place + 40].strip()}' does not start with a usable number. Save the "
            "drawing again as plain SVG."
        )
    return value, match.end()


class _Pen:
    """Follows the commands M L H V C S Q T A Z. Source: SVG 1.1, chapter 8."""

    def __init__(self) -> None:
        self.at = self.start = 0j
        self.curves: list[Curve] = []
        self._ended = False
        self._command = ""
        self._control = 0j
        """Last control point of the curve before, which S and T mirror."""

    def drawn(self, path: str) -> list[Curve]:
        place = 0
        for match in _COMMAND.finditer(path):
            if match.start() != place:
                break
            place = match.end()
            self._obey(match[1], match[2])
        if path[place:].strip():
            raise TrackError(
                f"'{path[place : place + 40].strip()}' is not a path command. Save the drawing "
                "again as plain SVG."
            )
        return self.curves

    def _obey(self, letter: str, text: str) -> None:
        command = letter.upper()
        if command == "Z":
            self._draw(_straight(self.at, self.start))
            self._ended, self._command = True, command
            return
        place = 0
        while True:
            values = []
            for kind in _KINDS[command]:
                value, place = _value(text, place, kind)
                values.append(value)
            base = self.at if letter.islower() else 0j
            self._step(command, values, base)
            self._command = command
            if _REST.match(text, place):
                return
            command = "L" if command == "M" else command

    def _step(self, command: str, values: list[float], base: complex) -> None:
        at = self.at
        if command == "H":
            return self._draw(_straight(at, complex(base.real + values[0], at.imag)))
        if command == "V":
            return self._draw(_straight(at, complex(at.real, base.imag + values[0])))
        if command == "A":
            end = base + complex(values[5], values[6])
            for curve in _arc(at, end, *values[:3], large=values[3] > 0, sweep=values[4] > 0):
                self._draw(curve)
            return None
        points = [base + complex(x, y) for x, y in zip(values[::2], values[1::2], strict=True)]
        if command == "M":
            return self._move(points[0])
        if command == "L":
            return self._draw(_straight(at, points[0]))
        if command in "ST":
            family = "CS" if command == "S" else "QT"
            mirrored = 2 * at - self._control if self._command and self._command in family else at
            points.insert(0, mirrored)
        self._control = points[-2]
        if command in "QT":
            control, end = points
            points = [at + (control - at) * 2 / 3, end + (control - end) * 2 / 3, end]
        return self._draw((at, points[0], points[1], points[2]))

    def _move(self, to: complex) -> None:
        self.at = self.start = to
        self._ended = bool(self.curves)

    def _draw(self, curve: Curve) -> None:
        if curve[0] != curve[3] or curve[1] != curve[2]:
            if self._ended:
                raise TrackError(
                    "the first path of the drawing has several pieces. Draw the centre line, not "
                    "the borders, as one path without gaps, and put it first."
                )
            self.curves.append(curve)
        self.at = curve[3]


def _arc(
    start: complex,
    end: complex,
    radius_x: float,
    radius_y: float,
    turned_deg: float,
    *,
    large: bool,
    sweep: bool,
) -> Iterator[Curve]:
    """In pieces of at most 90 degrees. Source: SVG 1.1, appendix F.6."""
    if start == end:
        return
    radius_x, radius_y = abs(radius_x), abs(radius_y)
    if min(radius_x, radius_y) < 1e-9:
        yield _straight(start, end)
        return
    turn = complex(math.cos(math.radians(turned_deg)), math.sin(math.radians(turned_deg)))

    def on_circle(point: complex) -> complex:
        level = point / turn
        return complex(level.real / radius_x, level.imag / radius_y)

    def on_ellipse(point: complex) -> complex:
        return complex(point.real * radius_x, point.imag * radius_y) * turn

    a, b = on_circle(start), on_circle(end)
    half = abs(b - a) / 2
    grown = max(1.0, half)  # radii that do not reach are scaled up
    away = math.sqrt(max(0.0, grown**2 - half**2)) * (1 if large == sweep else -1)
    middle = (a + b) / 2 + (b - a) / abs(b - a) * complex(0, -away)
    first = math.atan2((a - middle).imag, (a - middle).real)
    swept = math.atan2((b - middle).imag, (b - middle).real) - first
    if sweep and swept < 0:
        swept += 2 * math.pi
    if not sweep and swept > 0:
        swept -= 2 * math.pi
    pieces = max(1, math.ceil(abs(swept) / (math.pi / 2) - 1e-9))
    step = swept / pieces
    handle = 4 / 3 * math.tan(step / 4) * grown
    at = start
    for k in range(pieces):
        u, v = (
            complex(math.cos(t), math.sin(t)) for t in (first + k * step, first + (k + 1) * step)
        )
        p = on_ellipse(middle + grown * u + handle * u * 1j)
        q = on_ellipse(middle + grown * v - handle * v * 1j)
        stop = end if k == pieces - 1 else on_ellipse(middle + grown * v)
        yield at, p, q, stop
        at = stop
