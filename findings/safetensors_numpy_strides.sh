#!/usr/bin/env bash
# safetensors 0.8.0 with NumPy 2.4.6, compared with safetensors 0.7.0.
#
# What one expects: `save` of any array gives a file from which `load` reads the same values, or it
# raises an error, as safetensors.torch.save does for a tensor that is not contiguous.
# What happens: 0.8.0 writes the memory of the array from its first element on, whatever its strides
# are. A transposed array or every second row, as one cuts them out of a larger buffer, comes back in
# the right shape with other values. 0.7.0 copied such arrays in the right order.
# What helps: numpy.ascontiguousarray before save.
#
# Output seen:
#
#   0.7.0: transposed ok, every second row ok
#   0.8.0: transposed WRONG, every second row WRONG
#   0.8.0: made contiguous before: ok
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/ask.py" <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
from safetensors.numpy import load, save

rewards = np.arange(12, dtype=np.float32).reshape(4, 3)
found = []
for part in (rewards.T, rewards[::2]):
    found.append(np.array_equal(load(save({"rewards": part}))["rewards"], part))
    packed = np.ascontiguousarray(part)
    assert np.array_equal(load(save({"rewards": packed}))["rewards"], part)
words = ["ok" if good else "WRONG" for good in found]
print(f"{version('safetensors')}: transposed {words[0]}, every second row {words[1]}")
sys.exit(found != [sys.argv[1] == "right"] * 2)
PYTHON
for wanted in 0.7.0=right 0.8.0=wrong; do
    python3 -m venv --clear "$folder/venv"
    "$folder/venv/bin/pip" install --quiet "safetensors==${wanted%=*}" "numpy==2.4.6"
    "$folder/venv/bin/python" "$folder/ask.py" "${wanted#*=}"
done
echo "${wanted%=*}: made contiguous before: ok"
