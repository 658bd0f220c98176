#!/usr/bin/env bash
# mlflow-skinny 3.17.2.
#
# What one expects: after `pip install mlflow-skinny`, which is meant for logging, start_run() writes to
# the default place, as that of mlflow does.
# What happens: the default place is a SQLite database, for which libraries are missing; the error does
# not say which. The former default, a folder, is refused too.
#
# Output seen:
#
#   default (sqlite): UnsupportedModelRegistryStoreURIException:  Model registry functionality is unav
#   a folder (./mlruns): MlflowException: The filesystem tracking backend (e.g., './mlruns') is in mainte
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "mlflow-skinny==3.17.2"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import sys
import warnings

warnings.simplefilter("ignore")
import mlflow


def started() -> str:
    """What comes of a run at the chosen place."""
    try:
        with mlflow.start_run():
            return "a run"
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:80]


default = mlflow.get_tracking_uri().partition(":")[0]
plain = started()
print(f"default ({default}): {plain}")
mlflow.set_tracking_uri("./mlruns")
folder = started()
print(f"a folder (./mlruns): {folder}")
sys.exit(0 if "a run" not in (plain, folder) else 1)
PYTHON
