"""Drive a lap with an ONNX file: `python scripts/examples/drive_onnx.py policy.onnx [TRACK]`.

`dr-export onnx` writes the file and the NAME.model_metadata.json beside it. Only the simulator and
onnxruntime drive, neither our trainer nor PyTorch: pip install "drcli[onnx]"
"""

import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime

import drsim

model, world = Path(sys.argv[1]), (*sys.argv[2:], "reinvent_base")[0]
metadata = json.loads(model.with_suffix(".model_metadata.json").read_text())
space, sensors = metadata["action_space"], metadata["sensor"]
actions: drsim.Actions
if isinstance(space, list):
    actions = drsim.DiscreteActions(tuple((a["steering_angle"], a["speed"]) for a in space))
else:
    steering, speed = ((r["low"], r["high"]) for r in (space["steering_angle"], space["speed"]))
    actions = drsim.ContinuousActions(steering, speed)

session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
env = drsim.RacerEnv(world, actions=actions, sensors=sensors, start=0.0)
seen, info = env.reset(seed=0)
ended = False
while not ended:
    by_sensor = seen if isinstance(seen, dict) else {sensors[0]: seen}
    inputs = {
        port.name: np.float32(by_sensor[port.name.rpartition("/")[2]])[None]  # a batch of one
        for port in session.get_inputs()
    }
    output = session.run(None, inputs)[0][0]
    action = output.argmax() if isinstance(space, list) else output
    seen, _, terminated, truncated, info = env.step(action)
    ended = terminated or truncated
print(f"{info['status']} after {info['steps'] / 15:.1f} s, progress {info['progress']:.1f} %")
