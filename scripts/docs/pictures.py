"""Draws the pictures of docs/pictures: what our cameras see, and what OpenGL makes of it.

    python scripts/docs pictures [--into docs/pictures] [--frames DIR]

    camera-beside-opengl.png   our camera, `mujoco.Renderer` of the same scene, difference times 4
    camera-at-frames.png       our camera at the poses of three frames of the reference simulator
    randomisation.png          what `dr-video --knobs` draws with the defaults
    glare-and-reflections.png  the same poses: as usual, with glare, with reflections, both
    chase.png, top.png         the views of videos, in an object avoidance race

The reference frames are not ours to copy. With --frames, a folder that holds them as
gazebo-camera-1.png to -3.png, the second picture becomes camera-beside-frames.png, which shows each
of them to the right of ours: draw it into a folder outside the project.
"""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from camera import axes_of, both, boxes_along, poses_along, random_lenses
from numpy.typing import NDArray
from opengl_scene import choose_opengl, shrunk
from PIL import Image

from drcli.config.loading import load_settings
from drcli.view.video.knob_strip import draw_knobs
from drsim.car.car import FRONT
from drsim.race.solids import SHAPES
from drsim.sensing.lighting import Lamps
from drsim.sensing.scene import Scene, build_scene, lens_parts, render
from drsim.track.appearance import LUMA
from drsim.track.track import Track
from drsim.track.worlds import load_track
from drsim.viewing.car_eye import FollowingCamera, lens_above
from drsim.viewing.placed_objects import PlacedObject
from drsim.viewing.world_view import WorldView

Frames = NDArray[np.uint8]

FRAME_POSES = {
    1: (5.2523, 0.5919, 0.1314, 1.22, 13.63, 0.03),
    2: (4.9248, 2.9436, 0.1323, 158.20, 13.65, -0.07),
    3: (1.3160, 1.2453, 0.1306, -60.76, 13.48, 0.57),
}
"""Lens x, y and height in metres, yaw, pitch down and roll to the right in degrees, for each frame
of the reference simulator. Found by search."""

PATTERNS = {1: 3, 2: 45, 3: 21}
"""Places of lamps of which the glare is seen from these poses."""

COLORS, GREYS = 256, 56
"""Colours left in a coloured picture and in a grey one, to keep them small."""


def main() -> None:
    """Draw all pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--into", type=Path, default=Path("docs/pictures"))
    parser.add_argument("--frames", type=Path, help="folder with the reference frames")
    arguments = parser.parse_args()

    opengl = choose_opengl() != "disable"
    arguments.into.mkdir(parents=True, exist_ok=True)
    track = load_track("reinvent_base")
    scene = build_scene(track)
    pictures = at_frames(scene, arguments.frames) | race_pictures(track)
    pictures["glare-and-reflections.png"] = disturbed(scene)
    pictures["randomisation.png"] = knobs(track)
    if opengl:
        pictures["camera-beside-opengl.png"] = beside_opengl(track, scene)
    for name, pixels in pictures.items():
        colors = COLORS if pixels.ndim == 3 else GREYS
        full = Image.fromarray(pixels).convert("RGB")
        picture = full.quantize(colors, method=Image.Quantize.MAXCOVERAGE)
        if pixels.ndim == 3:
            # A second time, because only the palette of another picture is used with dithering.
            picture = full.quantize(palette=picture, dither=Image.Dither.FLOYDSTEINBERG)
        picture.save(arguments.into / name, optimize=True)
        size_kb = (arguments.into / name).stat().st_size / 1024
        print(f"{arguments.into / name}: {size_kb:.0f} kB", file=sys.stderr)


def beside_opengl(track: Track, scene: Scene) -> NDArray[np.uint8]:
    """Three rows of our frame, that of OpenGL and their difference; boxes stand in the last one."""
    random = np.random.default_rng(3)
    rows = []
    along = poses_along(track)
    for lenses, index, with_boxes in (
        (along, 0, False),
        (random_lenses(track, 1, random), 0, False),
        (along, 24, True),
    ):
        lens = lenses[0][index : index + 1], lenses[1][index : index + 1]
        boxes = boxes_along(track, lens[0], random) if with_boxes else None
        (ours,), (theirs,) = both(scene, *lens, boxes)
        difference = np.abs(ours.astype(int) - theirs)
        print(f"mean difference {difference.mean():.2f} greys", file=sys.stderr)
        rows.append(np.hstack([ours, theirs, np.minimum(4 * difference, 255).astype(np.uint8)]))
    return _twice(np.vstack(rows))


def at_frames(scene: Scene, folder: Path | None) -> dict[str, NDArray[np.uint8]]:
    """Our frames at the poses of the reference frames, beside these where they are at hand."""
    rows = []
    for index, (x_m, y_m, z_m, *degrees) in FRAME_POSES.items():
        ours = np.zeros((1, FRONT.rows, FRONT.columns), np.uint8)
        lens_mat = axes_of(*np.radians(degrees)[:, None])
        render(scene, np.array([[x_m, y_m, z_m]]), lens_mat, ours)
        row = [ours[0]]
        if folder is not None:
            with Image.open(folder / f"gazebo-camera-{index}.png") as opened:
                grey = np.asarray(opened.convert("RGB")) @ np.array(LUMA, np.float32)
            row.append(shrunk(grey, FRONT.columns, FRONT.rows))
            ground = slice(36, None)
            alike = np.corrcoef(ours[0, ground].ravel(), row[1][ground].ravel())[0, 1]
            print(f"frame {index}: correlation below the horizon {alike:.3f}", file=sys.stderr)
        rows.append(row)
    if folder is None:
        return {"camera-at-frames.png": _twice(np.hstack([row[0] for row in rows]))}
    return {"camera-beside-frames.png": _twice(np.vstack([np.hstack(row) for row in rows]))}


def disturbed(scene: Scene) -> NDArray[np.uint8]:
    """Our frames at the poses of the reference frames, and with lamps that disturb them."""
    rows = []
    for glare, reflections in ((0.0, 0.0), (0.7, 0.0), (0.0, 0.6), (0.5, 0.4)):
        row = []
        for index, (x_m, y_m, z_m, *degrees) in FRAME_POSES.items():
            lamps = Lamps(scene, 1)
            pattern = PATTERNS[index]
            lamps.begin(0, glare=glare, reflections=reflections, pattern=pattern)
            frame = np.zeros((1, FRONT.rows, FRONT.columns), np.uint8)
            lens = np.array([[x_m, y_m, z_m]]), axes_of(*np.radians(degrees)[:, None])
            render(scene, *lens, frame)
            lamps.reflect(slice(0, 1), frame, lens_parts(*lens))
            lamps.shine(slice(0, 1), frame, lens_parts(*lens))
            row.append(frame[0])
        rows.append(np.hstack(row))
    return _twice(np.vstack(rows))


def race_pictures(track: Track) -> dict[str, NDArray[np.uint8]]:
    """A car among six boxes from behind and from above."""
    distance_m = np.linspace(2.0, track.length_m - 1.0, 6)
    inner, outer = (track.pose_at(distance_m, lane) for lane in ("inner", "outer"))
    objects = np.where((np.arange(len(distance_m)) % 2 == 0)[:, None], inner, outer)
    poses = np.concatenate([track.pose_at(np.array([0.6])), objects]).tolist()
    names = ["race_car", *["box_obstacle"] * len(objects)]
    things = [
        PlacedObject(SHAPES[name], (x, y, yaw))
        for name, (x, y, yaw) in zip(names, poses, strict=True)
    ]
    view = WorldView(track)
    pictures = {
        "chase.png": view.frame(FollowingCamera().lens(things[0].pose), things),
        "top.png": view.frame(lens_above(track, view.size), things),
    }
    view.close()
    return pictures


def knobs(track: Track) -> NDArray[np.uint8]:
    """The filmstrip of `dr-video --knobs`."""
    with TemporaryDirectory() as folder:
        race = load_settings(Path(folder), contents={"run.env": b""}).race
        draw_knobs(race, track, Path(folder, "knobs.png"))
        return np.asarray(Image.open(Path(folder, "knobs.png")))


def _twice(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return pixels.repeat(2, axis=0).repeat(2, axis=1)


if __name__ == "__main__":
    main()
