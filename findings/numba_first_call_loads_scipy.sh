#!/usr/bin/env bash
# numba 0.68.1 (with numpy 2.4.6 and scipy 1.17.1).
#
# What one expects: a function that only adds numbers, and whose machine code lies in numba's cache, is
# called without any library of linear algebra. Whether scipy is installed makes no difference to it.
# What happens: the first call of any compiled function imports scipy.linalg, if scipy is installed,
# because numba then looks for the BLAS that a function may use. With numpy 2, that brings numpy.f2py,
# too. Each process that calls a compiled function pays for more than a hundred further modules.
#
# Output seen:
#
#   without scipy: scipy.linalg no, numpy.f2py no, cached: yes, modules loaded by the call: 73
#   with scipy: scipy.linalg yes, numpy.f2py yes, cached: yes, modules loaded by the call: 207
#
# It ends with 0 if the behaviour is as stated; the numbers of modules are not judged.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "numba==0.68.1" "numpy==2.4.6"
cd "$folder"
cat >adding.py <<'PYTHON'
import sys

import numba


@numba.njit(cache=True)
def add(a, b):
    return a + b


before = len(sys.modules)
assert add(1.0, 2.0) == 3.0
more = len(sys.modules) - before
cached = sum(add.stats.cache_hits.values()) == 1
said = {True: "yes", False: "no"}
found = [f"{name} {said[name in sys.modules]}" for name in ("scipy.linalg", "numpy.f2py")]
print(f"{', '.join(found)}, cached: {said[cached]}, modules loaded by the call: {more}")
PYTHON
look() {
    "$folder/venv/bin/python" adding.py >/dev/null # compiles, and fills the cache
    "$folder/venv/bin/python" adding.py
}
without=$(look)
"$folder/venv/bin/pip" install --quiet "scipy==1.17.1"
with=$(look)
echo "without scipy: $without"
echo "with scipy: $with"
[[ $without == "scipy.linalg no, numpy.f2py no, cached: yes"* ]]
[[ $with == "scipy.linalg yes, numpy.f2py yes, cached: yes"* ]]
