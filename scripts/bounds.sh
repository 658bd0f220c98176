#!/usr/bin/env bash
# Tries the bounds of pyproject.toml: each dependency at its lowest or its newest version. Not part of
# the checks of a change; run it every night, since new versions appear without one:
#
#   scripts/bounds.sh lowest
#   scripts/bounds.sh newest
#
# In an environment of its own, it runs the tests that start no worker processes, and a training with
# an evaluation. Warnings are no errors there: old versions warn about each other.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

case ${1:-} in
lowest) resolution=lowest-direct ;;
newest) resolution=highest ;;
*) sed -n '5,6s/^# *//p' "$0" >&2 && exit 2 ;;
esac
python=${PYTHON:-python3}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m venv "$work/venv"
pip() { "$work/venv/bin/python" -m pip --disable-pip-version-check --quiet "$@"; }
pip install --upgrade pip uv

# torch is pinned, and its CPU build needs nothing of CUDA.
"$work/venv/bin/uv" pip compile --quiet --resolution "$resolution" --no-annotate --no-header --no-emit-package triton \
    --extra analysis --extra onnx --extra tensorboard --extra tflite --extra video --extra web \
    pyproject.toml --output-file "$work/all.txt" >/dev/null
grep -vE '^(cuda|nvidia|torch=)' "$work/all.txt" >"$work/wanted.txt"
pip install --no-deps --extra-index-url https://download.pytorch.org/whl/cpu "$(grep '^torch=' "$work/all.txt")"
pip install --no-deps --requirement "$work/wanted.txt"
pip install --constraint "$work/wanted.txt" editables hatchling httpx hypothesis packaging pyte pytest pytest-timeout
pip install --no-deps --no-build-isolation --editable .
printf '%s\n' "$PWD" "$PWD/env" >"$(echo "$work"/venv/lib/python3.*/site-packages)/_editable_impl_drcli.pth"
"$work/venv/bin/python" -m pip check
"$work/venv/bin/python" -m drcli.base.installation

"$work/venv/bin/python" -m pytest -q -m "not nightly" -o filterwarnings= -p no:cacheprovider \
    tests/drsim tests/drcli/{base,bucket,config,convert,learn,metrics,model,records,view/video}
export PATH=$work/venv/bin:$PATH
mkdir "$work/racer" && cd "$work/racer"
dr init </dev/null
dr start-training --foreground --max-minutes 1 </dev/null
dr evaluate </dev/null
