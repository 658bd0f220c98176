#!/usr/bin/env bash
# Creates .venv and installs the project into it. When that is already done, it only imports every
# library that is needed, and installs again what is broken, such as a package whose files the upgrade
# of another one has deleted.
#
#   scripts/install.sh          what training, analysis, videos and the console need
#   scripts/install.sh dev      and what the tests need
#
# Every package has the version in constraints/ (written by scripts/lock.sh).
#
# PYTHON names the interpreter to use (default: the first Python 3.11 or newer found).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

extra=${1:-}
venv=.venv
locked=constraints/$extra.txt
[ -e "$locked" ] || locked=constraints/default.txt
stamp=$venv/.installed-${extra:-base}

find_python() {
    local candidate
    for candidate in "${PYTHON:-}" python3 python3.13 python3.12 python3.11 python; do
        if [ -n "$candidate" ] && "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
    echo "Python 3.11 or newer was not found. Install it, or set PYTHON to its path." >&2
    exit 1
}

# The usual index has a build with several gigabytes of CUDA libraries. Without an NVIDIA GPU the CPU
# build is installed from PyTorch's own index, if that can be reached; what it needs comes later, since
# that index has few versions of other packages.
install_torch() {
    local wanted cpu_index=https://download.pytorch.org/whl/cpu
    wanted=$(sed -n 's/^ *"\(torch==[^"]*\)".*/\1/p' pyproject.toml)
    if "$venv/bin/python" -c 'import importlib.metadata as m, sys; sys.exit("torch==" + m.version("torch").split("+")[0] != sys.argv[1])' "$wanted" 2>/dev/null; then
        return
    fi
    if ! command -v nvidia-smi >/dev/null 2>&1 && [ "$(uname -s)" = Linux ] &&
        "$venv/bin/python" -c 'import sys, urllib.request as u; u.urlopen(sys.argv[1] + "/torch/", timeout=5)' "$cpu_index" 2>/dev/null; then
        "$venv/bin/python" -m pip install --quiet --no-deps --index-url "$cpu_index" "$wanted"
    else
        "$venv/bin/python" -m pip install --quiet --constraint "$locked" "$wanted"
    fi
}

# drcli/base/installation.py
mend() { PIP_CONSTRAINT=$locked "$venv/bin/python" -P -m drcli.base.installation; }

if [ -e "$stamp" ] && [ "$stamp" -nt pyproject.toml ] && [ "$stamp" -nt "$locked" ]; then
    mend
    exit 0
fi
[ -x "$venv/bin/python" ] || "$(find_python)" -m venv "$venv"
echo "Installing into $venv ..." >&2
# The pip that comes with Python 3.11 takes minutes to read the index pages of boto3.
"$venv/bin/python" -m pip install --quiet --upgrade --constraint "$locked" pip || true
install_torch
# The second variable is for the build: hatchling and what it needs.
PIP_CONSTRAINT=$locked PIP_BUILD_CONSTRAINT=$locked \
    "$venv/bin/python" -m pip install --quiet --editable ".[${extra:-analysis,video,web}]"
# Python 3.11 and 3.12 read this file in the locale's character set, and fail to start when a path in
# it has other characters. Relative paths have none.
for packages in "$venv"/lib/python3.*/site-packages; do
    printf '%s\n' ../../../.. ../../../../env >"$packages/_editable_impl_drcli.pth"
done
mend
touch "$stamp"
