"""Whether the picture of a car's camera is what a model expects."""

import io
import math
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Annotated, Literal

from drcli.base.files import rewrite
from drcli.base.installation import lazy_imports
from drcli.base.report import View
from drcli.outside.car.car_address import CarError
from drcli.outside.car.car_config import CAMERA_MODE, ORIENTATION, OVERLAY, CarConfig, find_config
from drcli.outside.car.car_web import CarWeb

with lazy_imports():
    import requests
    from PIL import Image

STREAM = "/route?topic=/camera_pkg/display_mjpeg&width=160&height=120"
"""Pictures one after the other, before the car's software lays anything over them."""

PICTURE_WITHIN_S = 10.0
_LARGEST = 4_000_000
_BEGIN, _END = b"\xff\xd8\xff", b"\xff\xd9"

Way = Literal["upright", "upside down", "unknown"]

_SURE = 0.2
"""Of 700 simulated pictures of 35 tracks, none was misjudged, and 3 % were unknown; with changed
colours, light, glare and noise none and 52 %. No picture of a physical car was at hand.
"""


@dataclass(frozen=True)
class CameraCheck:
    """What a car's camera shows."""

    car: Annotated[str, "Address of the car."]
    picture: Annotated[str, "The file with the picture."]
    way: Annotated[str, "upright, upside down or unknown: a guess from the picture."]
    orientation: Annotated[
        int | None, "By how much the car turns its pictures, degrees; null if unknown."
    ] = None
    gray_overlay: Annotated[
        bool | None, "Whether the car lays a gray gradient over its pictures; null if unknown."
    ] = None
    problems: Annotated[list[str], "What does not fit, and what to do."] = field(
        default_factory=list
    )

    def view(self) -> View:
        turned = f"; the car turns it by {self.orientation} degrees" if self.orientation else ""
        way = "may be either way up" if self.way == "unknown" else f"looks {self.way}"
        yield f"The picture of the car {self.car} is in {self.picture}. It {way}{turned}."
        if self.gray_overlay is not None:
            yield f"The gray overlay is {'on' if self.gray_overlay else 'off'}."


def check_camera(car: CarWeb, out: Path) -> CameraCheck:
    """Take a picture, and compare it with the car's settings.

    Raises:
        CarError: The car sends no picture.
        SettingsError: The file cannot be written.
    """
    jpeg = read_picture(car)
    way = way_up(jpeg)
    config = find_config(car)
    rewrite(out, jpeg)
    orientation, overlay = None, None
    if config is not None:
        turned, laid_over = config.value(ORIENTATION), config.value(OVERLAY)
        orientation = turned if isinstance(turned, int) else None
        overlay = laid_over if isinstance(laid_over, bool) else None
    problems = [*_problems(way, config, out)]
    return CameraCheck(car.address.place, str(out), way, orientation, overlay, problems)


def read_picture(car: CarWeb) -> bytes:
    """The next picture of the camera, as JPEG."""
    end_s = time.monotonic() + PICTURE_WITHIN_S
    try:
        with closing(
            car.stream(STREAM, action="show its camera", timeout_s=PICTURE_WITHIN_S)
        ) as answer:
            for picture in pictures_of(answer, end_s):
                return picture
    except requests.exceptions.RequestException:
        pass
    raise CarError(
        f"The camera of the car {car.address.place} sent no picture within {PICTURE_WITHIN_S:g} s.",
        remedy="Look at `dr-car status`: is the camera connected? Open the camera view of the "
        "car's page once, which starts it, or restart the car.",
    )


def pictures_of(answer: "requests.Response", end_s: float = math.inf) -> Iterator[bytes]:
    """Pictures of a stream, as JPEG, until this time of the monotonic clock."""
    found = b""
    for chunk in answer.iter_content(1024):
        found += bytes(chunk)
        begin = found.find(_BEGIN)
        end = found.find(_END, begin)
        if 0 <= begin < end:
            yield found[begin : end + len(_END)]
            found = found[end + len(_END) :]
        if len(found) > _LARGEST or time.monotonic() > end_s:
            return


def way_up(jpeg: bytes) -> Way:
    """A guess: below the horizon lines cross the picture, above it there is less to see.

    Raises:
        CarError: It is not a picture.
    """
    try:
        with Image.open(io.BytesIO(jpeg)) as image:
            small = image.convert("L").resize((80, 60), Image.Resampling.BOX)
    except (OSError, SyntaxError, ValueError) as error:
        raise CarError(
            f"What the car's camera sent is not a picture ({error}).", remedy="Try again."
        ) from error
    greys = small.tobytes()
    rows = (greys[k : k + 80] for k in range(0, len(greys), 80))
    steps = [sum(abs(b - a) for a, b in pairwise(row)) / 79 for row in rows]
    above, below = fmean(steps[:15]), fmean(steps[-15:])
    sureness = (below - above) / max(below + above, 1.0)
    if abs(sureness) <= _SURE:
        return "unknown"
    return "upright" if sureness > 0 else "upside down"


def _problems(way: Way, config: CarConfig | None, picture: Path) -> Iterator[str]:
    mode = None if config is None else config.value(CAMERA_MODE)
    turned = None if config is None else config.value(ORIENTATION)
    if turned == 180 and mode == "legacy":
        yield (
            f"{ORIENTATION}=180 has no effect with {CAMERA_MODE}=legacy. Set {CAMERA_MODE}=modern "
            "with `dr-car config` if this car offers it, or mount the camera upright."
        )
    if way == "upright":
        return
    seen = "looks upside down" if way == "upside down" else "could not be judged"
    settings = [] if config is None else config.settings
    if not any(each.name == ORIENTATION and 180 in each.choices for each in settings):
        remedy = "mount the camera upright, because this car cannot turn its picture"
    elif mode == "legacy":
        remedy = f"mount the camera upright; cars turn pictures only with {CAMERA_MODE}=modern"
    else:
        other = 0 if turned == 180 else 180
        remedy = f"`dr-car config {ORIENTATION}={other}`, and restart the car"
        if mode == "auto":
            remedy += f" (with {CAMERA_MODE}=modern, which auto takes on a Raspberry Pi only)"
    yield (
        f"The picture {seen}. Look at {picture}: the road must be at the bottom. If it is at the "
        f"top: {remedy}."
    )
