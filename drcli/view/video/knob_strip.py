"""A filmstrip of each knob of domain randomisation: what episodes draw from its range."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from drcli.base.files import rewrite
from drcli.base.report import Col, bold, table
from drcli.base.report import View as Shown
from drcli.config.run_config import DriveConfig
from drcli.view.video.overlay import encoded
from drsim.arrays import Bytes
from drsim.car.conditions import Conditions, Realism
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.sensing.observations import Randomize
from drsim.sensing.scene import Scene, build_scene
from drsim.track.track import Track

SHOWN = 5
"""Episodes in a row."""

_DRAWN = 40
"""Episodes of which a row shows those that change the picture least, most, and between."""


@dataclass(frozen=True)
class Knob:
    """A setting that changes the picture from episode to episode.

    Attributes:
        example: What is drawn where run.env leaves the setting off; as in the preset `physical`.
        field: Of `Realism`, or empty.
        told: What an episode drew.
    """

    setting: str
    example: float = 0.0
    field: str = ""
    told: Callable[[Conditions], str] = lambda _: ""
    randomize: Randomize = "nothing"


KNOBS = (
    Knob("DR_SIM_IMAGE_NOISE", 4.0, "image_noise", lambda c: f"{c.image_noise:g} greys"),
    Knob("DR_SIM_BRIGHTNESS", 0.25, "brightness", lambda c: f"x {c.brightness:.2f}"),
    Knob("DR_SIM_BLUR", 1.0, "blur_px", lambda c: f"{c.blur_px:.2f} px"),
    Knob(
        "DR_SIM_CAMERA_ANGLE",
        1.5,
        "camera_angle_deg",
        lambda c: "roll {:+z.1f}°, pitch {:+z.1f}°, yaw {:+z.1f}°".format(*c.camera_turn_deg),
    ),
    Knob(
        "DR_SIM_CAMERA_SHIFT",
        0.005,
        "camera_shift_m",
        lambda c: "forward {:+z.0f}, left {:+z.0f}, up {:+z.0f} mm".format(
            *(1000.0 * metres for metres in c.camera_shift_m)
        ),
    ),
    Knob("DR_SIM_GLARE", 0.6, "glare", lambda c: f"strength {c.glare:.2f}"),
    Knob("DR_SIM_REFLECTIONS", 0.5, "reflections", lambda c: f"strength {c.reflections:.2f}"),
    Knob(
        "DR_SIM_GRAY_OVERLAY",
        0.5,
        "gray_overlay",
        lambda c: "with it" if c.gray_overlay else "without",
    ),
    Knob("DR_ENABLE_DOMAIN_RANDOMIZATION", randomize="lights"),
    Knob("DR_RANDOMIZE_TEXTURES", randomize="textures"),
)
"""One row of the picture each."""


@dataclass(frozen=True)
class KnobRow:
    """A row of the picture."""

    setting: Annotated[str, "The setting.", Col("setting")]
    value: Annotated[str, "What the episodes were drawn from.", Col("value")]
    example: Annotated[
        bool,
        "Whether the setting is off, and an example was drawn.",
        Col("", of=lambda row: "example, off in your settings" if row.example else ""),
    ]
    drawn: Annotated[
        list[str],
        "What the shown episodes drew, in the order of the picture; for lights and colours, how "
        "bright the picture became.",
    ]


@dataclass(frozen=True)
class KnobReport:
    """What `dr-video --knobs` drew."""

    file: Annotated[str, "The picture."]
    world: Annotated[str, "The track."]
    knobs: Annotated[list[KnobRow], "From the first row of the picture to the last."]

    def view(self) -> Shown:
        return [
            bold(f"Domain randomisation on {self.world}"),
            table(self.knobs),
            (f"Left as usual, then {SHOWN} of {_DRAWN} episodes: ", bold(self.file)),
        ]


def draw_knobs(race: DriveConfig, track: Track, path: Path) -> KnobReport:
    """Draw a picture with a row for each knob; SettingsError if it cannot be written."""
    scene = build_scene(track)
    usual = _frames(track, scene, 1, Realism(), "nothing")[0]
    rows, pictures = [], []
    for knob in KNOBS:
        set_to = getattr(race, knob.setting.removeprefix("DR_").lower())
        value = set_to or knob.example
        realism = Realism(**{knob.field: value}) if knob.field else Realism()
        frames = _frames(track, scene, _DRAWN, realism, knob.randomize)
        change = np.abs(frames.astype(np.int16) - usual).mean(axis=(1, 2))
        seeds = np.argsort(change)[np.linspace(0, _DRAWN - 1, SHOWN).round().astype(int)]
        if knob.field:
            drawn = [knob.told(realism.draw(int(seed))) for seed in seeds]
        else:
            drawn = [_mean(frame) for frame in frames[seeds]]
        row = KnobRow(knob.setting, f"{value:g}" if knob.field else "True", not set_to, drawn)
        rows.append(row)
        pictures.append((row, frames[seeds]))
    rewrite(path, encoded(_strip(usual, pictures), "PNG"))
    return KnobReport(str(path), track.name, rows)


def _frames(
    track: Track, scene: Scene, episodes: int, realism: Realism, randomize: Randomize
) -> Bytes:
    """What the network sees at the start of episodes 0, 1, ... Shape (n, 120, 160)."""
    simulation = Simulation(
        track,
        num_cars=episodes,
        reward_function=centre_line_reward,
        scene=scene,
        realism=realism,
        randomize=randomize,
    )
    cars = np.arange(episodes)
    simulation.reset(cars, np.zeros(episodes), seeds=cars.astype(np.uint64))
    simulation.close()
    return simulation.observations.copy()


def _mean(frame: Bytes) -> str:
    return f"mean grey {frame.mean():.0f}"


_SIZE = (240, 180)
_GAP, _HEADING, _LABEL = 8, 30, 22
_INK, _PAPER, _FAINT = 38, 255, 110


def _strip(usual: Bytes, rows: list[tuple[KnobRow, Bytes]]) -> Bytes:
    width, height = _SIZE
    across, down = width + _GAP, _HEADING + height + _LABEL
    sheet = Image.new("L", (across * (SHOWN + 1) + _GAP, down * len(rows) + _GAP), _PAPER)
    draw = ImageDraw.Draw(sheet)
    large, small = ImageFont.load_default(16), ImageFont.load_default(12)
    for number, (row, frames) in enumerate(rows):
        top = number * down
        heading = f"{row.setting}={row.value}" + (" (example)" if row.example else "")
        draw.text((_GAP, top + 8), heading, _INK, large)
        labels = [f"as usual, {_mean(usual)}", *row.drawn]
        for column, (frame, label) in enumerate(zip([usual, *frames], labels, strict=True)):
            left = _GAP + column * across
            picture = Image.fromarray(frame).resize(_SIZE, Image.Resampling.BICUBIC)
            sheet.paste(picture, (left, top + _HEADING))
            draw.text((left, top + _HEADING + height + 2), label, _FAINT, small)
    return np.asarray(sheet)
