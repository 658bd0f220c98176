"""Records a lap of a trained model as an animated picture: docs/pictures/lap.webp.

    python scripts/docs lap MODEL [--world reinvent_base] [--into docs/pictures]

MODEL is the model's folder in a local bucket, such as data/s3/bucket/rl-deepracer-sagemaker. The
picture shows the car from behind and, in a corner, what its camera sees. The policy takes its most
likely action.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from safetensors.torch import load_file

from drcli.convert.build_network import build_policy
from drcli.drive.build_race import actions_of
from drcli.learn.policy import Observation, decide
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drsim import CONTROL_HZ, RacerEnv

SIZE_PX = (400, 300)
"""Width and height of the picture."""

CAMERA_PX = (128, 96)
"""Width and height of the camera's frame in it."""

EVERY = 2
"""Steps from one picture to the next."""

SEED = 1
"""Of the start; any is as good."""


def main() -> None:
    """Drive from the start line until the lap is complete, and write the picture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("--world", default="reinvent_base")
    parser.add_argument("--into", type=Path, default=Path("docs/pictures"))
    arguments = parser.parse_args()

    pictures, info = drive(arguments.model, arguments.world)
    path = arguments.into / "lap.webp"
    pictures[0].save(
        path,
        save_all=True,
        append_images=pictures[1:],
        duration=round(1000 * EVERY / CONTROL_HZ),
        loop=0,
        quality=45,
        method=6,
    )
    print(f"{path}: {path.stat().st_size / 1024:.0f} kB, {info['status']}, {info['lap_time_s']} s")


def drive(model: Path, world: str) -> tuple[list[Image.Image], dict[str, object]]:
    """The pictures of a lap with the best checkpoint, and the last info of the environment."""
    metadata = ModelMetadata.from_bytes((model / "model" / "model_metadata.json").read_bytes())
    parameters = Hyperparameters.from_bytes((model / "ip" / "hyperparameters.json").read_bytes())
    index = json.loads((model / "model" / "deepracer_checkpoints.json").read_bytes())
    best = index["best_checkpoint"]["name"]
    policy = build_policy(metadata, parameters)
    policy.load_state_dict(load_file(model / "model" / f"{best}.safetensors"))
    actions = actions_of(metadata)
    env = RacerEnv(world, actions=actions, start=0.0, render_mode="rgb_array", view="chase")
    frame, info = env.reset(seed=SEED)
    pictures, over = [], False
    while not over:
        seen = Observation(
            torch.from_numpy(frame.transpose(2, 0, 1)[None].copy()),
            torch.zeros(1, 0),
            torch.zeros(1, policy.spec.state_dims),
        )
        noise = np.zeros((1, policy.spec.noise_dims), np.float32)
        chosen = decide(policy, seen, noise, np.array([True])).actions[0]
        frame, _, terminated, truncated, info = env.step(chosen)
        over = terminated or truncated
        if info["steps"] % EVERY == 0:
            pictures.append(picture(env.render(), frame))
    env.close()
    return pictures, info


def picture(chase: NDArray[np.uint8], camera: NDArray[np.uint8]) -> Image.Image:
    """The view from behind with the camera's frame in its upper right corner."""
    whole = Image.fromarray(chase).resize(SIZE_PX, Image.Resampling.LANCZOS)
    small = Image.fromarray(camera[:, :, 0]).convert("RGB").resize(CAMERA_PX)
    whole.paste(small, (SIZE_PX[0] - CAMERA_PX[0] - 6, 6))
    return whole


if __name__ == "__main__":
    main()
