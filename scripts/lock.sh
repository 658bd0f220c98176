#!/usr/bin/env bash
# Writes constraints/*.txt: the version of every package that scripts/install.sh installs, with all that
# these need, for every Python and processor that we support.
#
#   scripts/lock.sh                    as few changes as pyproject.toml asks for
#   scripts/lock.sh --upgrade          the newest versions of everything
#   scripts/lock.sh -P pillow          the newest version of one package
#
# Run the tests afterwards, and commit the files with the change that needed them.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
uv=$(command -v uv || true)
if [ -z "$uv" ]; then
    .venv/bin/python -m venv "$work/venv"
    "$work/venv/bin/pip" install --quiet uv
    uv=$work/venv/bin/uv
fi

lock() {
    local file=constraints/$1.txt
    shift
    [ ! -e "$file" ] || cp "$file" "$work/locked.txt"
    printf 'pip\nhatchling\n' |
        "$uv" pip compile --quiet --universal --python-version 3.11 --no-annotate --no-header \
            pyproject.toml - --output-file "$work/locked.txt" "$@" >/dev/null
    {
        echo "# Versions that scripts/install.sh installs; written by scripts/lock.sh, not by hand."
        cat "$work/locked.txt"
    } >"$work/file"
    mv "$work/file" "$file"
    rm "$work/locked.txt"
}

lock default --extra onnx --extra openvino --extra tflite --extra analysis --extra video --extra web --extra tensorboard --extra ray --extra gpu --extra limit --extra bags --extra dev "$@"
# moviepy needs an older pillow than everything else may have.
lock rendering --extra rendering "$@"
