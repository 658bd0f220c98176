"""Draw frames with the CUDA kernel and with the processor, and print how much they differ.

With NUMBA_ENABLE_CUDASIM=1, numba's simulator runs the kernel; frames are small then.
"""

import json
import os
import sys

import numpy as np

from drsim.car.car import FRONT, CameraModel
from drsim.race.solids import Box, Shape, Solids
from drsim.sensing import cuda_camera, observations
from drsim.sensing.lighting import Lighting
from drsim.sensing.scene import Light, build_scene, lens_parts, lens_pose, render
from drsim.track.appearance import look_of
from drsim.track.worlds import load_track

IS_SIMULATED = os.environ.get("NUMBA_ENABLE_CUDASIM") == "1"
SMALL = CameraModel(columns=40, rows=22)


def main() -> None:
    """Compare a case, named on the command line."""
    case = sys.argv[1]
    camera = SMALL if IS_SIMULATED else FRONT
    track = load_track("reinvent_base")
    scene = build_scene(track)
    cars = 2 if IS_SIMULATED else 40
    draw = np.random.default_rng(7)
    points = track.center[draw.integers(0, len(track.center), cars)]
    pos = np.column_stack([points + draw.uniform(-0.6, 0.6, (cars, 2)), np.zeros(cars)])
    yaw = draw.uniform(-np.pi, np.pi, cars)
    cos, sin, zero, one = np.cos(yaw), np.sin(yaw), np.zeros(cars), np.ones(cars)
    mat = np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]]).transpose(2, 0, 1)
    lens_pos, lens_mat = lens_pose(pos, np.ascontiguousarray(mat), camera)
    light: Light | None = None
    if case == "light":
        lighting = Lighting(cars, [look_of("reinvent_base")], textures=True)
        for car in range(cars):
            lighting.draw(car, draw)
        light = lighting.of(slice(None))
    if case == "lost":
        lens_pos[0, 2] = np.nan
        lens_pos[1, :2] += 1e7
    if case == "renderer":
        _compare_renderers(scene, lens_pos, lens_mat, camera)
        return
    expected = np.zeros((cars, camera.rows, camera.columns), np.uint8)
    render(scene, lens_pos, lens_mat, expected, camera, light=light)
    gpu = cuda_camera.CudaCamera(scene, cars, camera=camera)
    gpu.draw([lens_parts(lens_pos, lens_mat, camera)], np.arange(cars), light)
    gpu.fetch()
    gpu.wait()
    _print(gpu.frames[:, 0], expected)


def _compare_renderers(scene, lens_pos, lens_mat, camera) -> None:
    """Two eyes, of which one car is drawn anew, with a box before it."""
    observations.FRONT = camera  # the renderers have no other
    cars = len(lens_pos)
    drawn = []
    for gpu in (None, cuda_camera.CudaCamera(scene, cars, eyes=2, camera=camera)):
        box = Box((0.0, 0.0), (0.3, 0.3), 0.0, 0.4, (90.0, 120.0, 60.0))
        solids = Solids(cars, [Shape("box", (box,), (0.3, 0.3))])
        ahead = lens_pos[:, None, :2] + 0.8 * lens_mat[:, None, :2, 0]
        solids.move(np.arange(cars), ahead, np.zeros((cars, 1)))
        renderer = observations.FrameRenderer(
            [observations.Channel([scene])],
            np.zeros(cars, np.int64),
            1,
            eyes=2,
            solids=solids,
            gpu=gpu,
        )
        renderer.start(np.arange(cars), lens_pos, lens_mat)
        renderer.finish()
        renderer.start(np.array([cars - 1]), lens_pos[::-1].copy(), lens_mat[::-1].copy())
        renderer.finish()
        if gpu is not None:
            on_gpu = gpu.device_frames.copy_to_host()
            assert np.array_equal(on_gpu, renderer.frames)
        drawn.append(renderer.frames.copy())
    _print(drawn[1], drawn[0])


def _print(found, expected) -> None:
    apart = np.abs(found.astype(int) - expected)
    numbers = {
        "largest": int(apart.max()),
        "different": float((apart > 0).mean()),
        "greys": len(np.unique(expected)),
    }
    print(json.dumps(numbers))


if __name__ == "__main__":
    main()
