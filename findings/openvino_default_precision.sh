#!/usr/bin/env bash
# OpenVINO 2026.4.1 (with NumPy), on a processor with bfloat16 instructions (AVX-512 BF16 or AMX).
#
# What one expects: a model whose constants, inputs and outputs are float32 is computed in float32.
# What happens: where the processor has bfloat16, the CPU plugin computes in it by default, so that
# results have two to three digits. The same model on an older processor has seven.
# What helps: compile_model(..., {"INFERENCE_PRECISION_HINT": "f32"}).
#
# Output seen on an Intel processor with AVX-512 and AMX:
#
#   the processor has BF16: True
#   by default <Type: 'bfloat16'>: largest error 0.17 of values up to 69
#   with the hint f32 <Type: 'float32'>: largest error 2e-05
#
# It ends with 0 if the default is bfloat16 exactly where the processor has it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "openvino==2026.4.1" "numpy<3"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import openvino as ov
import openvino.opset13 as op

random = np.random.default_rng(0)
weights = random.standard_normal((512, 256)).astype(np.float32)
row = random.standard_normal((1, 512)).astype(np.float32)
wanted = row.astype(np.float64) @ weights.astype(np.float64)
entry = op.parameter([1, 512], np.float32)
model = ov.Model([op.matmul(entry, op.constant(weights), False, False)], [entry])
core = ov.Core()
has_bf16 = "BF16" in core.get_property("CPU", "OPTIMIZATION_CAPABILITIES")
print(f"the processor has BF16: {has_bf16}")


def largest_error(hints: dict[str, str]) -> tuple[str, float]:
    """The precision that was chosen, and how far the results are from those of NumPy."""
    compiled = core.compile_model(model, "CPU", hints)
    chosen = str(compiled.get_property("INFERENCE_PRECISION_HINT"))
    return chosen, float(np.abs(compiled(row)[0] - wanted).max())


chosen, plain = largest_error({})
print(f"by default {chosen}: largest error {plain:.1g} of values up to {np.abs(wanted).max():.0f}")
named, exact = largest_error({"INFERENCE_PRECISION_HINT": "f32"})
print(f"with the hint f32 {named}: largest error {exact:.1g}")
sys.exit(0 if exact < 1e-3 and (plain > 1e-2) == has_bf16 == ("bfloat16" in chosen) else 1)
PYTHON
