"""Writes frames as H.264 for browsers, or as a GIF."""

import math
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from drcli.base.errors import NotAvailable, SettingsError
from drcli.base.files import hand_out
from drcli.base.installation import import_error

Frame = NDArray[np.uint8]

_QUALITY = 21
"""x264's constant rate factor: 18 looks like the original, 28 does not."""

_BT709, _LIMITED = 1, 1
"""Matrix, primaries and transfer of H.273; brightness from 16 to 235."""

_QUEUE = 8
_SAMPLED = 12
GIF_FPS = 10
"""A GIF counts hundredths of a second."""

GIF_COLUMNS = 400
MOST_GIF_PICTURES = 1200


class Writer(Protocol):
    """Takes a film's frames."""

    @property
    def full(self) -> bool:
        """Whether it takes no more."""

    def add(self, frame: Frame) -> None:
        """Add a frame, RGB. Shape (rows, columns, 3), the same for all."""


def require_encoder() -> Any:
    """The H.264 library.

    Raises:
        NotAvailable: It is not installed, or cannot be loaded.
    """
    try:
        import av
    except (ImportError, OSError) as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else "no reason given"
        missing = isinstance(error, ModuleNotFoundError) and error.name == "av"
        what = "which is not installed" if missing else f"which cannot be loaded: {reason}"
        raise (None if missing else import_error(error)) or NotAvailable(
            f"An MP4 video needs the package av, {what}.",
            remedy='Install it with `pip install "drcli[video]"` (in a checkout: '
            "`scripts/install.sh video`), or make a GIF, which needs nothing more.",
        ) from None
    return av


@contextmanager
def mp4(path: Path, size: tuple[int, int], fps: int) -> Iterator[Writer]:
    """Write a video; `path` exists once it is complete.

    Raises:
        NotAvailable: As for `require_encoder`.
        SettingsError: The file cannot be written.
    """
    av = require_encoder()
    with _whole(path) as part:
        writer = _Mp4(av, part, size, fps)
        try:
            yield writer
            writer.finish()
        finally:
            writer.close()


@contextmanager
def gif(path: Path, fps: int) -> Iterator[Writer]:
    """Write a GIF; `path` exists once it is complete.

    Raises:
        SettingsError: The file cannot be written.
    """
    with _whole(path) as part:
        writer = _Gif(fps)
        yield writer
        writer.finish(part)


class _Mp4:
    """Encodes on its own thread."""

    full = False

    def __init__(self, av: Any, path: Path, size: tuple[int, int], fps: int) -> None:
        rows, columns = size
        # The index goes before the pictures, so that a browser plays before it has everything.
        options = {"movflags": "+faststart"}
        self._av = av
        self._file = av.open(str(path), "w", format="mp4", options=options)
        try:
            self._stream = self._file.add_stream("libx264", rate=Fraction(fps))
        except Exception:
            self._file.close()
            raise NotAvailable(
                "The package av is installed without the encoder libx264.",
                remedy='Install it again with `pip install --force-reinstall "drcli[video]"`.',
            ) from None
        self._stream.width, self._stream.height = columns, rows
        self._stream.pix_fmt = "yuv420p"
        self._stream.options = {"preset": "veryfast", "crf": str(_QUALITY)}
        self._stream.codec_context.thread_count = 2
        # Without these, browsers take a video of 720 rows or more for BT.709, which is not what the
        # encoder makes of RGB by itself, and show other colours.
        for name in ("colorspace", "color_primaries", "color_trc"):
            setattr(self._stream.codec_context, name, _BT709)
        self._stream.codec_context.color_range = _LIMITED
        self._queue: Queue[Frame | None] = Queue(_QUEUE)
        self._error: BaseException | None = None
        self._thread = Thread(target=self._encode, name="encoder", daemon=True)
        self._thread.start()

    def add(self, frame: Frame) -> None:
        """The writer keeps the frame."""
        self._raise()
        self._queue.put(np.ascontiguousarray(frame))

    def finish(self) -> None:
        self._queue.put(None)
        self._thread.join()
        self._raise()
        for packet in self._stream.encode(None):
            self._file.mux(packet)

    def close(self) -> None:
        if self._thread.is_alive():
            self._error = self._error or RuntimeError("dropped")
            with suppress(Exception):
                self._queue.put(None, timeout=5.0)
            self._thread.join(10.0)
        self._file.close()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _encode(self) -> None:
        while (frame := self._queue.get()) is not None:
            if self._error is not None:
                continue  # so that nobody waits for room in the queue
            try:
                picture = self._av.VideoFrame.from_ndarray(frame, format="rgb24")
                picture = picture.reformat(format="yuv420p", dst_colorspace=_BT709)
                for packet in self._stream.encode(picture):
                    self._file.mux(packet)
            except BaseException as error:
                self._error = error


@dataclass(frozen=True)
class Form:
    columns: int
    rows: int
    fps: int
    frames: int


def form_of(path: Path, film: Form) -> Form:
    if path.suffix.lower() != ".gif":
        return film
    fps = min(film.fps, GIF_FPS)
    frames = min(math.ceil(film.frames * fps / film.fps), MOST_GIF_PICTURES)
    return Form(GIF_COLUMNS, round(film.rows * GIF_COLUMNS / film.columns), fps, frames)


def most_frames(paths: Sequence[Path], fps: int) -> float:
    """How many frames of a film the longest of these files takes; infinity for a video."""
    if any(path.suffix.lower() != ".gif" for path in paths):
        return math.inf
    return math.ceil((MOST_GIF_PICTURES - 1) * fps / min(fps, GIF_FPS)) + 1


class _Gif:
    def __init__(self, fps: int) -> None:
        self._step = fps / min(fps, GIF_FPS)
        self._fps = min(fps, GIF_FPS)
        self._seen, self._next = 0, 0.0
        self._pictures: list[Image.Image] = []

    @property
    def full(self) -> bool:
        return len(self._pictures) >= MOST_GIF_PICTURES

    def add(self, frame: Frame) -> None:
        if self._seen >= self._next and not self.full:
            picture = Image.fromarray(frame)
            height = round(picture.height * GIF_COLUMNS / picture.width)
            self._pictures.append(picture.resize((GIF_COLUMNS, height), Image.Resampling.BOX))
            self._next += self._step
        self._seen += 1

    def finish(self, path: Path) -> None:
        count = len(self._pictures)
        chosen = [self._pictures[k * count // _SAMPLED] for k in range(_SAMPLED)]
        wide, high = self._pictures[0].size
        sheet = Image.new("RGB", (wide, high * _SAMPLED))
        for number, picture in enumerate(chosen):
            sheet.paste(picture, (0, number * high))
        palette = sheet.quantize(255, method=Image.Quantize.MEDIANCUT)
        few = [
            picture.quantize(palette=palette, dither=Image.Dither.NONE)
            for picture in self._pictures
        ]
        few[0].save(
            path,
            "GIF",
            save_all=True,
            append_images=few[1:],
            duration=round(1000 / self._fps),
            loop=0,
            optimize=False,
        )


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    try:
        number, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        os.close(number)
    except OSError as error:
        raise _cannot_write(path, error) from None
    part = Path(name)
    try:
        yield part
        hand_out(part)
        part.replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from None
    finally:
        part.unlink(missing_ok=True)


def _cannot_write(path: Path, error: OSError) -> SettingsError:
    return SettingsError(
        f"{path} cannot be written: {error.strerror or error}.",
        remedy="Name another file with --out, in a folder with room that you may write to.",
    )
