#!/usr/bin/env bash
# MLflow 3.17.2 (mlflow-skinny with a SQLite database).
#
# What one expects: the "latest" value of a metric, which the table of runs shows and searches filter by,
# is the one that was logged last.
# What happens: it is the one with the highest step. After a training goes back to an earlier
# checkpoint, the abandoned value stays until the step is passed again.
#
# Output seen:
#
#   logged: step 1: 1.0, step 2: 2.0, step 3: 9.0, then again step 2: 5.0
#   latest value: 9.0
#   runs with reward < 6: 0
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "mlflow-skinny==3.17.2" sqlalchemy alembic
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import logging
import sys

import mlflow

logging.disable(logging.INFO)
mlflow.set_tracking_uri("sqlite:///mlflow.db")
with mlflow.start_run() as run:
    for step, value in ((1, 1.0), (2, 2.0), (3, 9.0), (2, 5.0)):
        mlflow.log_metric("reward", value, step=step)
client = mlflow.MlflowClient()
latest = client.get_run(run.info.run_id).data.metrics["reward"]
found = client.search_runs([run.info.experiment_id], "metrics.reward < 6")
print("logged: step 1: 1.0, step 2: 2.0, step 3: 9.0, then again step 2: 5.0")
print(f"latest value: {latest}")
print(f"runs with reward < 6: {len(found)}")
sys.exit(0 if latest == 9.0 and not found else 1)
PYTHON
