#!/usr/bin/env bash
# numba 0.68.1.
#
# What one expects: a function with cache=True gives the result of the code that is there.
# What happens: its machine code contains that of the functions that it calls, and is kept until its own
# file changes. After an update of a compiled function in another file, it goes on with the old one,
# in every new process.
#
# Output seen:
#
#   factor() returns 2.0: doubled(1.0) is 2.0
#   factor() returns 3.0: doubled(1.0) is 2.0
#   doubled.py got a comment: doubled(1.0) is 3.0
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "numba==0.68.1"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import os
import subprocess
import sys
from pathlib import Path

FACTOR = "from numba import njit\n\n@njit\ndef factor():\n    return {}\n"
DOUBLED = (
    "from numba import njit\nfrom factor import factor\n\n"
    "@njit(cache=True)\ndef doubled(x):\n    return x * factor()\n"
)
os.environ["PYTHONDONTWRITEBYTECODE"] = "1"


def doubled() -> str:
    """What a new process gets."""
    call = [sys.executable, "-c", "from doubled import doubled; print(doubled(1.0))"]
    return subprocess.run(call, capture_output=True, text=True, check=True).stdout.strip()


Path("doubled.py").write_text(DOUBLED)
Path("factor.py").write_text(FACTOR.format(2.0))
found = [doubled()]
print(f"factor() returns 2.0: doubled(1.0) is {found[-1]}")
Path("factor.py").write_text(FACTOR.format(3.0))
found.append(doubled())
print(f"factor() returns 3.0: doubled(1.0) is {found[-1]}")
Path("doubled.py").write_text(DOUBLED + "# changed\n")
found.append(doubled())
print(f"doubled.py got a comment: doubled(1.0) is {found[-1]}")
sys.exit(0 if found == ["2.0", "2.0", "3.0"] else 1)
PYTHON
