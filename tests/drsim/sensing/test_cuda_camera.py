"""Frames of the CUDA kernel equal those of the processor.

Without a GPU, numba's simulator runs the kernel, which must be chosen before numba is imported. So
each comparison is a process of its own.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

COMPARISON = Path(__file__).with_name("compare_cuda_frames.py")


@pytest.mark.nightly
@pytest.mark.parametrize("case", ["usual", "light", "lost", "renderer"])
def test_frames_differ_by_one_grey_at_most(case):
    found = compare(case, simulated=True)

    assert found["largest"] <= 1
    assert found["different"] <= 0.01
    assert found["greys"] > 5


@pytest.mark.parametrize("case", ["usual", "light", "lost", "renderer"])
def test_a_gpu_draws_the_same_frames(case):
    if not has_gpu():
        pytest.skip("needs an NVIDIA GPU and numba-cuda")

    found = compare(case, simulated=False)

    assert found["largest"] <= 1
    assert found["greys"] > 5


def compare(case, *, simulated):
    """How a comparison came out; see the script."""
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": str(int(simulated))}
    ran = subprocess.run(
        [sys.executable, COMPARISON, case],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


def has_gpu():
    """Whether numba finds a GPU."""
    asked = "from numba import cuda; raise SystemExit(not cuda.is_available())"
    ran = subprocess.run([sys.executable, "-c", asked], check=False, capture_output=True)
    return ran.returncode == 0
