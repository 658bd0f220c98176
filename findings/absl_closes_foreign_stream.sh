#!/usr/bin/env bash
# OpenVINO 2026.4.1 with absl-py 2.5.1 (which tensorboard brings), and uvicorn 0.54.0.
#
# What one expects: a stream that is standard error for a while belongs to who made it, as in a test
# runner or with `contextlib.redirect_stderr`; no library closes it.
# What happens: `import openvino` imports absl.logging where absl is installed, whose handler keeps the
# standard error of that moment. Any `logging.config.dictConfig`, such as the one that uvicorn makes
# for each server, closes all handlers of the process, and absl's closes its stream, unless that is the
# standard error of now.
#
# Output seen:
#
#   closed after the import: False, after a server without log_config: False, with uvicorn's own: True
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "openvino==2026.4.1" "absl-py==2.5.1" "uvicorn==0.54.0"
"$folder/venv/bin/python" - <<'PYTHON'
import contextlib
import io

import uvicorn

ours = io.StringIO()
with contextlib.redirect_stderr(ours):
    import openvino  # noqa: F401

found = [ours.closed]
uvicorn.Config("", log_config=None)
found.append(ours.closed)
uvicorn.Config("")
found.append(ours.closed)
print(
    f"closed after the import: {found[0]}, after a server without log_config: {found[1]}, "
    f"with uvicorn's own: {found[2]}"
)
if found != [False, False, True]:
    raise SystemExit("The behaviour has changed.")
PYTHON
