#!/usr/bin/env bash
# MoviePy 2.2.1, with which Gymnasium 1.4.0 writes the videos of RecordVideo.
#
# What one expects: the video of an episode has all its frames, with the last one, in which a car
# leaves the track or crosses the line.
# What happens: ImageSequenceClip adds up 1/fps for each frame, multiplies the sum by fps and rounds down.
# At many lengths the sum is a little too small, and the last frame is missing: at 15 frames per second at
# 437 of the lengths up to 1,000 frames. It knows nothing of the number of frames that it was given.
#
# Output seen (frames made and frames in the file, at 15 frames per second):
#
#   22 -> 22, 23 -> 23, 24 -> 23, 25 -> 24, 26 -> 25
#   the last frame is missing: 24, 25, 26
#   lengths up to 1,000 at which a frame is lost: 437
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "gymnasium==1.4.0" "moviepy==2.2.1" "imageio-ffmpeg==0.8.1" "numpy<2.5"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import sys
from pathlib import Path

import gymnasium as gym
import imageio_ffmpeg
import numpy as np
from gymnasium.wrappers import RecordVideo
from moviepy import ImageSequenceClip

FPS, STEP = 15, 9


class Brighter(gym.Env):
    """Each frame is brighter than the one before."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": FPS}
    observation_space = gym.spaces.Discrete(1)
    action_space = gym.spaces.Discrete(1)
    render_mode = "rgb_array"

    def __init__(self, frames: int) -> None:
        self.frames, self.at = frames, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = 0
        return 0, {}

    def step(self, action):
        self.at += 1
        return 0, 0.0, self.at == self.frames - 1, False, {}

    def render(self):
        return np.full((64, 64, 3), STEP * self.at, np.uint8)


def recorded(frames: int) -> list[int]:
    """Brightness of the frames in the file."""
    env = RecordVideo(Brighter(frames), f"videos-{frames}")
    env.reset()
    while not env.step(0)[2]:
        pass
    env.close()
    [path] = Path(f"videos-{frames}").glob("*.mp4")
    pictures = imageio_ffmpeg.read_frames(path)
    next(pictures)
    return [int(np.frombuffer(picture, np.uint8).mean()) for picture in pictures]


lengths, lost = range(22, 27), {24, 25, 26}
videos = {frames: recorded(frames) for frames in lengths}
print(", ".join(f"{frames} -> {len(videos[frames])}" for frames in lengths))
before = {n for n in lengths if round(videos[n][-1] / STEP) == n - 2}
print("the last frame is missing:", ", ".join(map(str, sorted(before))))
picture = np.zeros((2, 2, 3), np.uint8)
clips = (ImageSequenceClip([picture] * n, fps=FPS) for n in range(1, 1001))
fewer = sum(int(clip.duration * FPS) < len(clip.sequence) for clip in clips)
print("lengths up to 1,000 at which a frame is lost:", fewer)
sys.exit(before != lost or any(len(videos[n]) != n - (n in lost) for n in lengths))
PYTHON
