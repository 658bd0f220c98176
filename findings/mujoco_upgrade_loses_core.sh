#!/usr/bin/env bash
# MuJoCo 3.17.0, upgraded to 4.0.0 by pip 26.3, on Linux.
#
# What one expects: after `pip install mujoco==4.0.0` without an error, `import mujoco` works.
# What happens: it raises ImportError, and `pip check` finds nothing. MuJoCo 4 is three packages
# (mujoco, mujoco-core, mujoco-studio) that write into the folder of the first. pip installs what a
# package needs before the package, and removes an old version just before it installs the new one:
# 1. mujoco-core 4.0.0 overwrites files of mujoco 3.17.0,
# 2. mujoco 3.17.0 is removed, with all files that have these names,
# 3. mujoco 4.0.0 brings only its own files.
# What helps: to install all three again (--force-reinstall --no-deps), or another environment.
#
# Output seen:
#
#   pip check after the upgrade: No broken requirements found.
#   import after the upgrade: ImportError: The 'mujoco' package is installed, but its core bindings
#   files of mujoco-core that are missing: 142 of 206
#   import after all three were installed again: 4.0.0
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
cd "$folder"
pip() { "$folder/venv/bin/python" -m pip --quiet --disable-pip-version-check "$@"; }
pip install pip==26.3
pip install mujoco==3.17.0
pip install mujoco==4.0.0
echo "pip check after the upgrade: $("$folder/venv/bin/python" -m pip check)"
said=$("$folder/venv/bin/python" -c 'import mujoco' 2>&1 | grep '^ImportError' || true)
echo "import after the upgrade: ${said%% (*}"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import files

ours = [file for file in files("mujoco-core") if file.suffix != ".pyc"]
missing = [file for file in ours if not file.locate().exists()]
print(f"files of mujoco-core that are missing: {len(missing)} of {len(ours)}")
PYTHON
pip install --force-reinstall --no-deps mujoco==4.0.0 mujoco-core==4.0.0 mujoco-studio==4.0.0
mended=$("$folder/venv/bin/python" -c 'import mujoco; print(mujoco.__version__)')
echo "import after all three were installed again: $mended"
[[ $said == *"core bindings"* && $mended == 4.0.0 ]]
