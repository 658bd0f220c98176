#!/usr/bin/env bash
# PyTorch 2.13.0 (with NumPy), on a processor, one thread.
#
# What one expects: row 0 of `layer(x[:n])` is the same for every n.
# What happens: its last bits depend on n. The libraries below (MKL for float32, oneDNN for bfloat16)
# choose by the shape of a product how to add up. `torch.use_deterministic_algorithms(True)` does not
# change this: it promises equal results for equal calls only.
# What is the same bits: products of one shape, whatever is in the other rows.
#
# Output seen on an Intel processor with AVX-512 and AMX:
#
#   float32 11264 -> 512: row 0 differs from that of 64 rows at 15 of 64 sizes: 1 to 15
#   float32 512 -> 1: row 0 differs from that of 64 rows at 3 of 64 sizes: 1 to 3
#   float32 11264 -> 512: the same bits in products of 16 rows, at each place and beside other rows
#
# At which sizes depends on the processor. It ends with 0 if the behaviour is as stated. With
# PIP_INDEX_URL=https://download.pytorch.org/whl/cpu pip leaves out what only GPUs need.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "torch==2.13.0" numpy
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import torch

torch.set_num_threads(1)
torch.manual_seed(0)
torch.use_deterministic_algorithms(True)
MOST = 64


def differing(inputs: int, outputs: int) -> list[int]:
    """Numbers of rows with which row 0 gets other bits than with `MOST` rows."""
    layer, x = torch.nn.Linear(inputs, outputs), torch.randn(MOST, inputs)
    row = layer(x)[0]
    return [n for n in range(1, MOST + 1) if not torch.equal(layer(x[:n])[0], row)]


found = []
with torch.inference_mode():
    for inputs, outputs in ((11264, 512), (512, 1)):
        sizes = differing(inputs, outputs)
        found.append(sizes)
        where = f": {sizes[0]} to {sizes[-1]}" if sizes else ""
        print(
            f"float32 {inputs} -> {outputs}: row 0 differs from that of {MOST} rows at "
            f"{len(sizes)} of {MOST} sizes{where}"
        )
    layer, row = torch.nn.Linear(11264, 512), torch.randn(11264)
    results = []
    for place in range(16):
        x = torch.randn(16, 11264)
        x[place] = row
        results.append(layer(x)[place])
    same = all(torch.equal(results[0], result) for result in results)
print(
    f"float32 11264 -> 512: {'the same' if same else 'OTHER'} bits in products of 16 rows, at each "
    "place and beside other rows"
)
sys.exit(0 if all(found) and same else 1)
PYTHON
