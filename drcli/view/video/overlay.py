"""Texts and drawings over a film."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from typing import Any, Literal

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from drsim.arrays import Bytes, Floats

RGB = tuple[int, int, int]

_WHITE, _PALE, _DIM = (255, 255, 255), (206, 214, 224), (150, 160, 174)
_ACCENT, _GOOD, _BAD = (255, 172, 40), (96, 214, 120), (255, 92, 82)
_PANEL_LIGHT = 0.42
_HEIGHT = 480
"""Sizes are for this height."""

MOST_BARS = 24
"""Of more actions, the likeliest are shown."""


@dataclass(frozen=True)
class Titles:
    """What stays the same in an episode.

    Attributes:
        what: Model and checkpoint, or file.
        where: Track and episode.
        actions: (degrees, m/s) of discrete ones.
    """

    racer: str
    what: str
    where: str
    actions: tuple[tuple[float, float], ...] = ()
    ghosts: tuple[tuple[str, RGB], ...] = ()


@dataclass(frozen=True, eq=False)
class Readings:
    """What changes from frame to frame; None where unknown.

    Attributes:
        speed_mps: Measured.
        steering_deg: Requested, left positive.
        reward: Sum so far.
        good: Whether `status` is good news.
        camera: Grey or RGB.
        asked: Degrees and m/s.
        spread: The same, above 16 % and 84 % of a training's draws.
    """

    time_s: float
    speed_mps: float
    steering_deg: float
    progress: float
    reward: float
    step_reward: float
    resets: int
    status: str
    good: bool
    camera: Bytes | None
    probabilities: Floats | None
    asked: tuple[float, float]
    spread: tuple[tuple[float, float], tuple[float, float]] | None
    value: float | None
    fastest_mps: float


class Overlay:
    """Draws over frames of one size."""

    def __init__(self, size: tuple[int, int], titles: Titles) -> None:
        """`size` is rows and columns."""
        self.rows, self.columns = size
        self._titles = titles
        self._s = self.rows / _HEIGHT

    def px(self, length: float) -> int:
        return max(1, round(length * self._s))

    def draw(self, frame: Bytes, now: Readings, track_map: Image.Image | None) -> Bytes:
        """The map has an alpha channel."""
        margin, right = self.px(10), self.columns - self.px(10)
        top_right = self.px(10)
        boxes = [self._name_box(), self._figures_box()]
        camera_px = (self.px(160), self.px(120))
        if now.camera is not None:
            top_right += camera_px[1] + self.px(6)
        chances = self._chances_box(top_right, right, now)
        if chances is not None:
            boxes.append(chances)
        if track_map is not None:
            left, top = right - track_map.width, self.rows - self.px(16) - track_map.height
            boxes.append((left - self.px(4), top - self.px(4), right, top + track_map.height))
        for box in boxes:
            _darken(frame, box)
        if now.camera is not None:
            _paste_camera(frame, now.camera, (right - camera_px[0], margin), camera_px)
        image = Image.fromarray(frame)
        draw = ImageDraw.Draw(image)
        self._names(draw)
        self._figures(draw, now)
        if chances is not None:
            self._chances(draw, chances, now)
        if track_map is not None:
            image.paste(track_map, (left - self.px(2), top - self.px(2)), track_map)
        self._progress(draw, now)
        if now.status:
            self._status(draw, now)
        return np.asarray(image)

    def _name_box(self) -> tuple[int, int, int, int]:
        lines = [self._titles.what, self._titles.where, *(name for name, _ in self._titles.ghosts)]
        widths = [_font(self.px(19)).getlength(self._titles.racer)]
        widths += [_font(self.px(11)).getlength(line) + self.px(12) for line in lines]
        width = min(round(max(widths)) + self.px(20), self.columns // 2)
        margin = self.px(10)
        height = self.px(58 + 15 * len(self._titles.ghosts))
        return margin, margin, margin + width, margin + height

    def _names(self, draw: ImageDraw.ImageDraw) -> None:
        left, top, right, _ = self._name_box()
        x, room = left + self.px(10), right - left - self.px(16)
        big, small = _font(self.px(19)), _font(self.px(11))
        _text(draw, (x, top + self.px(4)), _cut(self._titles.racer, big, room), big, _WHITE)
        rows = ((self._titles.what, _PALE), (self._titles.where, _DIM))
        for number, (line, color) in enumerate(rows):
            place = (x, top + self.px(27 + 14 * number))
            _text(draw, place, _cut(line, small, room), small, color)
        for number, (name, ghost) in enumerate(self._titles.ghosts):
            y = top + self.px(58 + 15 * number)
            dot = (x, y + self.px(2), x + self.px(8), y + self.px(10))
            draw.ellipse(dot, fill=ghost)
            _text(draw, (x + self.px(13), y - self.px(1)), _cut(name, small, room), small, _PALE)

    def _figures_box(self) -> tuple[int, int, int, int]:
        margin, bottom = self.px(10), self.rows - self.px(16)
        return margin, bottom - self.px(104), margin + self.px(196), bottom

    def _figures(self, draw: ImageDraw.ImageDraw, now: Readings) -> None:
        left, top, right, _ = self._figures_box()
        x, end = left + self.px(10), right - self.px(10)
        small, middle = _font(self.px(11)), _font(self.px(13))
        _text(draw, (x, top + self.px(3)), clock(now.time_s), _font(self.px(28)), _WHITE)
        resets = f"{now.resets} reset" + ("" if now.resets == 1 else "s")
        width = small.getlength(resets)
        color = _BAD if now.resets else _DIM
        _text(draw, (round(end - width), top + self.px(8)), resets, small, color)
        progress = f"{min(max(now.progress, 0.0), 100.0):.0f} %"
        _text(
            draw,
            (round(end - small.getlength(progress)), top + self.px(22)),
            progress,
            small,
            _PALE,
        )

        y = top + self.px(42)
        _text(draw, (x, y), "speed", small, _DIM)
        bar = (x + self.px(50), y + self.px(4), end - self.px(52), y + self.px(10))
        draw.rectangle(bar, fill=(70, 78, 90))
        share = min(max(now.speed_mps / max(now.fastest_mps, 1e-6), 0.0), 1.0)
        draw.rectangle(
            (bar[0], bar[1], bar[0] + round(share * (bar[2] - bar[0])), bar[3]), fill=_ACCENT
        )
        self._right(draw, (end, y - self.px(1)), f"{now.speed_mps:.1f} m/s", middle)

        y = top + self.px(61)
        _text(draw, (x, y), "steering", small, _DIM)
        bar = (x + self.px(50), y + self.px(4), end - self.px(52), y + self.px(10))
        draw.rectangle(bar, fill=(70, 78, 90))
        middle_x = (bar[0] + bar[2]) // 2
        tip = middle_x - round(min(max(now.steering_deg / 30.0, -1.0), 1.0) * (bar[2] - bar[0]) / 2)
        draw.rectangle((min(tip, middle_x), bar[1], max(tip, middle_x), bar[3]), fill=_GOOD)
        draw.line((middle_x, bar[1] - 1, middle_x, bar[3] + 1), fill=_WHITE)
        self._right(draw, (end, y - self.px(1)), f"{now.steering_deg:+.0f}°", middle)

        y = top + self.px(80)
        _text(draw, (x, y), "reward", small, _DIM)
        step = f"{now.step_reward:+.2f}"
        _text(draw, (x + self.px(50), y), step, small, _GOOD if now.step_reward > 0 else _PALE)
        self._right(draw, (end, y - self.px(1)), _short(now.reward), middle)

    def _right(self, draw: Any, place: tuple[int, int], text: str, font: Any) -> None:
        _text(draw, (round(place[0] - font.getlength(text)), place[1]), text, font, _WHITE)

    def _chances_box(self, top: int, right: int, now: Readings) -> tuple[int, int, int, int] | None:
        if now.probabilities is None and now.spread is None:
            return None
        return right - self.px(160), top, right, top + self.px(74)

    def _chances(
        self, draw: ImageDraw.ImageDraw, box: tuple[int, int, int, int], now: Readings
    ) -> None:
        left, top, right, bottom = box
        small = _font(self.px(10))
        inner = (left + self.px(8), top + self.px(18), right - self.px(8), bottom - self.px(8))
        title = f"{now.asked[0]:+.0f}°  {now.asked[1]:.1f} m/s"
        _text(draw, (inner[0], top + self.px(3)), "action", small, _DIM)
        self._right(draw, (inner[2], top + self.px(3)), title, small)
        if now.probabilities is None:
            self._ranges(draw, inner, now)
            return
        order = _bar_order(now.probabilities, self._titles.actions)
        count = len(order)
        chosen = int(np.argmax(now.probabilities))
        wide, high = inner[2] - inner[0], inner[3] - inner[1]
        for place, action in enumerate(order):
            begin = inner[0] + wide * place / count
            end = max(
                inner[0] + wide * (place + 1) / count - max(1.0, 0.14 * wide / count), begin + 1
            )
            share = float(now.probabilities[action])
            color = _ACCENT if action == chosen else (120, 170, 235)
            draw.rectangle((begin, inner[3] - 1, end, inner[3]), fill=(84, 92, 104))
            draw.rectangle((begin, inner[3] - round(share * high), end, inner[3]), fill=color)

    def _ranges(
        self, draw: ImageDraw.ImageDraw, inner: tuple[int, int, int, int], now: Readings
    ) -> None:
        assert now.spread is not None
        low, high = now.spread
        for row, (limit, full, mirrored) in enumerate(
            ((-30.0, 60.0, True), (0.0, max(now.fastest_mps, 1e-6), False))
        ):
            y = inner[1] + (inner[3] - inner[1]) * (1 + 2 * row) // 4

            def at(
                value: float, limit: float = limit, full: float = full, m: bool = mirrored
            ) -> int:
                share = min(max((value - limit) / full, 0.0), 1.0)
                share = 1.0 - share if m else share  # left is left
                return round(inner[0] + share * (inner[2] - inner[0]))

            draw.line((inner[0], y, inner[2], y), fill=(84, 92, 104), width=self.px(2))
            ends = sorted((at(low[row]), at(high[row])))
            draw.line((ends[0], y, ends[1], y), fill=(120, 170, 235), width=self.px(5))
            x, radius = at(now.asked[row]), self.px(4)
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=_ACCENT)

    def _progress(self, draw: ImageDraw.ImageDraw, now: Readings) -> None:
        top = self.rows - self.px(6)
        draw.rectangle((0, top, self.columns, self.rows), fill=(28, 32, 40))
        share = min(max(now.progress, 0.0), 100.0) / 100.0
        draw.rectangle((0, top, round(share * self.columns), self.rows), fill=_ACCENT)

    def _status(self, draw: ImageDraw.ImageDraw, now: Readings) -> None:
        font = _font(self.px(22))
        width = font.getlength(now.status)
        x, y = (self.columns - width) / 2, self.px(96)
        pad = self.px(10)
        box = (x - pad, y - self.px(4), x + width + pad, y + self.px(28))
        draw.rounded_rectangle(box, radius=self.px(6), fill=(24, 28, 36))
        _text(draw, (round(x), y), now.status, font, _GOOD if now.good else _BAD)


def encoded(picture: Bytes, form: Literal["JPEG", "PNG"]) -> bytes:
    """As JPEG a quarter as large; the smallest PNG would take ten times as long."""
    data = BytesIO()
    Image.fromarray(picture).save(data, form, quality=88)
    return data.getvalue()


def clock(seconds: float) -> str:
    thousandths = round(max(seconds, 0.0) * 1000)
    minutes, rest = divmod(thousandths, 60_000)
    if minutes >= 60:
        return f"{minutes // 60}:{minutes % 60:02d}:{rest / 1000:04.1f}"
    return f"{minutes}:{rest / 1000:06.3f}"


def _short(number: float) -> str:
    return f"{number:.1f}" if abs(number) < 1e5 else f"{number:.3g}"


def _bar_order(probabilities: Floats, actions: Sequence[tuple[float, float]]) -> list[int]:
    shown = list(range(len(probabilities)))
    if len(shown) > MOST_BARS:
        shown = np.argsort(-probabilities)[:MOST_BARS].tolist()
    if len(actions) == len(probabilities):
        shown.sort(key=lambda action: (-actions[action][0], actions[action][1]))
    return shown


def _darken(frame: Bytes, box: tuple[int, int, int, int]) -> None:
    left, top, right, bottom = (max(0, side) for side in box)
    part = frame[top:bottom, left:right]
    part[:] = (part * np.float32(_PANEL_LIGHT) + np.array([7, 9, 13], np.float32)).astype(np.uint8)


def _paste_camera(
    frame: Bytes, camera: Bytes, place: tuple[int, int], size: tuple[int, int]
) -> None:
    picture = Image.fromarray(camera)
    if picture.size != size:
        picture = picture.resize(size, Image.Resampling.BILINEAR)
    shown = np.asarray(picture.convert("RGB"))
    left, top = place
    frame[top - 2 : top + size[1] + 2, left - 2 : left + size[0] + 2] = 240
    frame[top : top + size[1], left : left + size[0]] = shown


@cache
def _font(size: int) -> Any:
    return ImageFont.load_default(size)


def _cut(text: str, font: Any, room: int) -> str:
    if font.getlength(text) <= room:
        return text
    while text and font.getlength(text + "…") > room:
        text = text[:-1]
    return text + "…"


def _text(draw: Any, place: tuple[int, int], text: str, font: Any, color: RGB) -> None:
    draw.text(place, text, font=font, fill=color)
