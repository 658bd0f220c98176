"""SVG path data, the text of the attribute `d`, as cubic Bezier curves."""

import math
import re
from collections.abc import Iterator

from drsim.errors import TrackError

Curve = tuple[complex, complex, complex, complex]
"""A cubic Bezier curve: start, two control points, end, as x + y i."""

FURTHEST = 1e9
"""Larger numbers are refused: rounding would swallow the drawing."""

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
"""What follows each command: numbers and flags."""


def path_curves(path: str) -> list[Curve]:
    """The curves of a path, each starting where the last one ends.

    Args:
        path: Path data with the commands M L H V C S Q T A Z, absolute or relative.

    Raises:
        TrackError: The text is not a path, or one of several pieces.
    """
    return _Pen().drawn(path)


def straight(start: complex, end: complex) -> Curve:
    """A straight line as a curve."""
    return start, start + (end - start) / 3, end - (end - start) / 3, end


def numbers(text: str) -> Iterator[float]:
    """The numbers of a list, separated by blanks or commas.

    Raises:
        TrackError: The text is not such a list, or a number is beyond `FURTHEST`.
    """
    place = 0
    while not _REST.match(text, place):
        value, place = _value(text, place, "n")
        yield value


def _value(text: str, place: int, kind: str) -> tuple[float, int]:
    """The number or flag at a place in a text, and the place behind it."""
    match = (_NUMBER if kind == "n" else _FLAG).match(text, place)
    value = float(match[1]) if match else math.inf
    if match is None or abs(value) > FURTHEST:
        raise TrackError(
            f"'{text[place : place + 40].strip()}' does not start with a usable number. Save the "
            "drawing again as plain SVG."
        )
    return value, match.end()


class _Pen:
    """Follows the commands of a path. Source: SVG 1.1, chapter 8."""

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
            self._draw(straight(self.at, self.start))
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
            return self._draw(straight(at, complex(base.real + values[0], at.imag)))
        if command == "V":
            return self._draw(straight(at, complex(at.real, base.imag + values[0])))
        if command == "A":
            end = base + complex(values[5], values[6])
            for curve in _arc(at, end, *values[:3], large=values[3] > 0, sweep=values[4] > 0):
                self._draw(curve)
            return None
        points = [base + complex(x, y) for x, y in zip(values[::2], values[1::2], strict=True)]
        if command == "M":
            return self._move(points[0])
        if command == "L":
            return self._draw(straight(at, points[0]))
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
    """An arc of an ellipse, in pieces of at most 90 degrees. Source: SVG 1.1, appendix F.6."""
    if start == end:
        return
    radius_x, radius_y = abs(radius_x), abs(radius_y)
    if min(radius_x, radius_y) < 1e-9:
        yield straight(start, end)
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
