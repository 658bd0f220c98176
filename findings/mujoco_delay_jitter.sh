#!/usr/bin/env bash
# MuJoCo 4.0.0.
#
# What one expects: an actuator with a delay of ten time steps, and a buffer with room for more, always
# gets the control of ten steps ago.
# What happens: the engine looks for the sample of `time - delay`, and time is a sum of rounded steps.
# Without interpolation (`interp="zoh"`, the default), a delay of a whole number of steps lies on the
# border between two samples, so that rounding decides: in some stretches of a simulation the delay
# is ten steps, in others eleven. Which ones depends on the time step. It is always ten with a buffer
# of exactly ten samples, which has nothing older, and with interp="linear", where the border
# between two samples means nothing.
#
# Output seen:
#
#   step 0.01 s, 12 samples, zoh: 10 steps late 1552 times, 11 steps late 1398 times
#   step 0.1 s, 12 samples, zoh: 10 steps late 917 times, 11 steps late 2033 times
#   step 0.01 s, 10 samples, zoh: 10 steps late 2950 times
#   step 0.01 s, 12 samples, linear: 10 steps late 2950 times
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "mujoco==4.0.0"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import collections
import sys

import mujoco

LATE, STEPS = 10, 3000
MODEL = """
<mujoco>
  <option timestep="{step}" gravity="0 0 0"/>
  <worldbody><body><joint name="axle"/><geom size="1" mass="1"/></body></worldbody>
  <actuator><motor joint="axle" delay="{delay}" nsample="{samples}" interp="{interp}"/></actuator>
</mujoco>
"""


def lateness(step: float, samples: int, interp: str) -> dict[int, int]:
    """How often the motor acts on the control of how many steps ago, after the buffer is full."""
    text = MODEL.format(step=step, delay=LATE * step, samples=samples, interp=interp)
    model = mujoco.MjModel.from_xml_string(text)
    data, found = mujoco.MjData(model), collections.Counter()
    for number in range(STEPS):
        data.ctrl[0] = number
        mujoco.mj_step(model, data)
        if number >= 50:
            found[round(number - data.actuator_force[0])] += 1
    return dict(sorted(found.items()))


results = []
for question in ((0.01, 12, "zoh"), (0.1, 12, "zoh"), (0.01, 10, "zoh"), (0.01, 12, "linear")):
    seen = lateness(*question)
    results.append(sorted(seen))
    told = ", ".join(f"{steps} steps late {times} times" for steps, times in seen.items())
    print(f"step {question[0]} s, {question[1]} samples, {question[2]}: {told}")
sys.exit(results != [[10, 11], [10, 11], [10], [10]])
PYTHON
