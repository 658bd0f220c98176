"""What a worker writes into which of its logs, as a process of its own."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from drcli.base import log as log_files
from drcli.config.loading import load_settings
from drcli.records.job import Job
from drcli.records.run_record import json_log, log_file

PROGRAM = """
import sys
from drcli.base.log import plain, traces
from drcli.workers import print_limit, worker_process

def main(job, stop_signal):
    plain.info("Policy training> x")
    traces.info("SIM_TRACE_LOG:0,1")
    print("our own")
    sys.stdout.flush()
    for text in ("theirs 1.5\\n", "no end"):
        print_limit.theirs.write(text)
    print_limit.reward_logger.warning("It failed.")

worker_process.run("sim-1", main)
"""


@pytest.fixture
def logs(tmp_path):
    """Runs the worker above, and reads its logs."""

    def run(**settings) -> dict[str, str]:
        (tmp_path / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=team/model\n")
        (tmp_path / "system.env").write_text("".join(f"{n}={v}\n" for n, v in settings.items()))
        config = load_settings(tmp_path, environ={}).run
        job = Job(config, "start", 1, None, tmp_path, os.getpid())
        path = log_file(tmp_path, "team/model", "sim-1")
        path.parent.mkdir(parents=True)
        with path.open("ab") as log:
            process = job.spawn(
                [sys.executable, "-c", PROGRAM],
                stdout=log,
                stderr=subprocess.STDOUT,
                env={log_files.VARIABLE: str(path)},
            )
        assert process.wait(60) == 0
        files = [path, json_log(path), log_file(tmp_path, "team/model", "reward-1")]
        return {file.name: file.read_text() for file in files if file.exists()}

    return run


def test_prints_are_in_the_log_and_in_one_of_their_own(logs):
    found = logs(DR_LOG_JSON=True)

    lines = found["reward-1.log"].splitlines()
    assert lines[0] == "theirs 1.5"
    assert any(line.endswith("WARNING It failed.") for line in lines)
    assert "no end" in found["reward-1.log"]
    assert "our own" not in found["reward-1.log"]
    for text in ("theirs 1.5", "no end", "our own", "SIM_TRACE_LOG:0,1"):
        assert text in found["sim-1.log"]

    records = [json.loads(line) for line in found["sim-1.jsonl"].splitlines()]
    printed = [record["message"] for record in records if record.get("event") == "print"]
    assert printed[0] == "theirs 1.5"
    assert printed[-1] == "no end"
    assert ("WARNING", "It failed.") in [(r["level"], r["message"]) for r in records]
    assert not any("SIM_TRACE_LOG" in record["message"] for record in records)


def test_there_are_no_json_lines_unless_the_racer_wants_them(logs):
    assert sorted(logs()) == ["reward-1.log", "sim-1.log"]


def test_paths_of_logs_lie_where_log_guru_does_not_trip_over_them():
    paths = [log_file(Path("w"), "m", name) for name in ("sim-0", "reward-0", "trainer")]

    assert [str(path) for path in paths] == [
        "w/data/logs/robomaker/m/sim-0.log",
        "w/data/logs/reward/m/reward-0.log",
        "w/data/logs/sagemaker/m/trainer.log",
    ]
