#!/usr/bin/env bash
# Runs a command as on a processor without wide instructions (AVX and later), where floats are summed
# in another order:
#
#   scripts/narrow.sh .venv/bin/python -m pytest tests/drsim
#
# Every library has its own switch. What a processor does not have cannot be switched off.
set -euo pipefail
python=$(dirname "${BASH_SOURCE[0]}")/../.venv/bin/python

# NumPy wants the names of the features that it uses on this processor, and warns of any other.
names=$("$python" -c '
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__
print(*(name for name in __cpu_dispatch__ if __cpu_features__.get(name)))')
[ -z "$names" ] || export NPY_DISABLE_CPU_FEATURES=$names
export NUMBA_CPU_NAME=generic                                    # its cache keeps both apart
export ATEN_CPU_CAPABILITY=default                               # torch's own loops
if [ "$(uname -m)" = x86_64 ]; then
    export OPENBLAS_CORETYPE=Nehalem                             # products of matrices in NumPy
    export ONEDNN_MAX_CPU_ISA=SSE41                              # convolutions in torch
    export MKL_ENABLE_INSTRUCTIONS=SSE4_2                        # products of matrices in torch
    export GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX,-AVX2,-FMA,-AVX512F  # sines of the C library
fi
exec "$@"
