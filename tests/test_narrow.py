"""`scripts/narrow.sh`: the same programs as on a processor without wide instructions."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "scripts" / "narrow.sh"

ASKED = """
import json
import warnings
warnings.simplefilter("error")
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__
import torch
from numba.core.registry import cpu_target

print(json.dumps({
    "numpy": [name for name in __cpu_dispatch__ if __cpu_features__[name]],
    "numba": cpu_target.target_context.codegen().magic_tuple()[1],
    "torch": torch.backends.cpu.get_cpu_capability(),
}))
"""


@pytest.mark.skipif(
    not (SCRIPT.parents[1] / ".venv").is_dir(), reason="the script needs the project's own .venv"
)
def test_each_library_leaves_out_what_not_every_processor_has():
    done = subprocess.run(
        [SCRIPT, sys.executable, "-c", ASKED], check=True, capture_output=True, text=True
    )

    assert done.stderr == ""
    assert json.loads(done.stdout) == {"numpy": [], "numba": "generic", "torch": "DEFAULT"}
