#!/usr/bin/env bash
# PyTorch 2.13.0, on a processor.
#
# What one expects: manual_seed takes seeds of 64 bits, so two different seeds give different numbers.
# What happens: a generator of the processor uses the lower 32 bits only, without a warning, and yet
# `initial_seed` returns all 64. Seeds that a program composes, such as `run << 32 | iteration`, give the
# same numbers in all runs; those that are cut from a hash collide after some ten thousand. NumPy's
# generators use all bits.
#
# Output seen:
#
#   seeds 7, 7 + 2**32 and 7 + 2**63: 1 order of ten minibatches, 1 first weights
#   initial_seed of the second: 4294967303
#   NumPy with the same seeds: 3 orders
#
# It ends with 0 if the behaviour is as stated. With
# PIP_INDEX_URL=https://download.pytorch.org/whl/cpu pip leaves out what only GPUs need.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "torch==2.13.0" numpy
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import torch

SEEDS = (7, 7 + 2**32, 7 + 2**63)
orders, weights, numpys = set(), set(), set()
for seed in SEEDS:
    generator = torch.Generator().manual_seed(seed)
    assert generator.initial_seed() == seed
    orders.add(tuple(torch.randperm(10, generator=generator).tolist()))
    torch.manual_seed(seed)
    weights.add(tuple(torch.nn.Linear(3, 2).weight.flatten().tolist()))
    numpys.add(tuple(np.random.default_rng(seed).permutation(10).tolist()))
print(
    f"seeds 7, 7 + 2**32 and 7 + 2**63: {len(orders)} order of ten minibatches, "
    f"{len(weights)} first weights"
)
print("initial_seed of the second:", torch.Generator().manual_seed(SEEDS[1]).initial_seed())
print(f"NumPy with the same seeds: {len(numpys)} orders")
sys.exit((len(orders), len(weights), len(numpys)) != (1, 1, 3))
PYTHON
