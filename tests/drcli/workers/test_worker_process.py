"""Worker processes: what they leave behind when they end."""

import os
import re
import subprocess
import sys
from dataclasses import replace

import pytest

from drcli.base import log as log_files
from drcli.base.errors import NoAnswer, SettingsError
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.config.loading import load_settings
from drcli.records.job import Job, WorkerExit
from drcli.workers import worker_process

DEAF = """import signal

def reward_function(params):
    while True:
        try:
            signal.pause()
        except:
            pass
"""

CALLING = """
import drsim.episode.reward_deadline
from pathlib import Path
from drcli.workers import worker_process as process
from drsim.episode.load_reward import load_reward_function
from drsim.episode.reward import checked_reward

def main(job, stop_signal):
    drsim.episode.reward_deadline.PATIENCE_S = drsim.episode.reward_deadline.REPEAT_S = 0.05
    checked_reward(load_reward_function(job.folder / "reward_function.py"), {}, 0.1)

process.run("sim-0", main)
"""


class StopSignal:
    """Of a worker that nobody asks to stop."""

    def should_stop(self) -> bool:
        return False


FAILING = """
from drcli.workers import worker_process as process

def main(job, stop_signal):
    raise %s("why")

process.run("sim-0", main)
"""


@pytest.fixture
def job(working_folder, tmp_path):
    """A start whose folder is for this test alone."""
    return Job(load_settings(working_folder).run, "abc", 0, None, tmp_path, os.getpid())


def ended(job: Job, script: str) -> tuple[int, WorkerExit | None]:
    """Exit code and `WorkerExit` of a worker."""
    process = job.spawn([sys.executable, "-c", script], stdout=subprocess.DEVNULL)
    return process.wait(60), WorkerExit.read(job.folder, "sim-0")


@pytest.mark.parametrize(("cloud", "waits_s"), [("local", 60.0), ("remote", 900.0)])
def test_a_worker_waits_longer_for_a_bucket_that_nobody_here_can_restart(
    job, monkeypatch, cloud, waits_s
):
    now_s = [0.0]

    def pause(seconds: float) -> None:
        now_s[0] += seconds

    monkeypatch.setattr(
        worker_process,
        "open_bucket",
        lambda storage, **options: S3Bucket(
            Endpoint("http://127.0.0.1:1", "key", "secret"),
            storage.bucket,
            clock=lambda: now_s[0],
            pause=pause,
            **options,
        ),
    )
    storage = replace(job.config.storage, cloud=cloud)
    job = replace(job, config=replace(job.config, storage=storage))
    bucket = worker_process.open_own_bucket(job, StopSignal())

    with pytest.raises(NoAnswer):
        bucket.get("k")

    assert now_s[0] == pytest.approx(waits_s)


def test_a_reward_function_that_swallows_its_deadline_ends_the_training_with_a_sentence(job):
    (job.folder / "reward_function.py").write_text(DEAF)

    code, words = ended(job, CALLING)

    assert code > 0  # by a signal would mean to start it again
    assert words is not None
    assert (words.code, words.final) == (SettingsError.code, True)
    assert (
        "Reward function error: The reward function in reward_function.py, line 6" in words.message
    )
    assert "did not return within 0.1 s and swallows what is raised" in words.message


@pytest.mark.parametrize("kind", ["ValueError", "KeyboardInterrupt", "BaseException"])
def test_whatever_ends_a_worker_leaves_its_exit_reason(job, kind):
    code, words = ended(job, FAILING % kind)

    assert code != 0
    assert words is not None
    assert words.message == f"sim-0 failed: {kind}: why"


def test_a_failure_is_in_the_log_with_time_level_and_traceback(job, tmp_path):
    path = tmp_path / "sim-0.log"
    process = job.spawn(
        [sys.executable, "-c", FAILING % "ValueError"], env={log_files.VARIABLE: str(path)}
    )

    assert process.wait(60) == 1
    log = path.read_text()
    assert re.search(r"^\d{4}-\d\d-\d\dT[\d:.]{12}Z INFO sim-0 started as process", log, re.M)
    assert "Z ERROR sim-0 failed: ValueError: why\nTraceback (most recent call last):\n" in log


def test_whatever_a_reward_function_prints_reaches_the_log_in_any_locale(job, monkeypatch):
    for name, value in {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}.items():
        monkeypatch.setenv(name, value)

    command = [sys.executable, "-c", r"print('Kurve \u2192 \ud800')"]
    with job.spawn(command, stdout=subprocess.PIPE) as process:
        said, _ = process.communicate()

    assert process.returncode == 0
    assert said.decode() == "Kurve → \\ud800\n"


LIMITED = """
import resource
from drcli.workers import worker_process as process

def main(job, stop_signal):
    pages = int(open("/proc/self/statm").read().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, ((pages << 12) + (256 << 20),) * 2)
    bytearray(1 << 30)

process.run("sim-0", main)
"""


def test_a_worker_without_memory_says_so_and_is_no_bug(job):
    code, words = ended(job, LIMITED)

    assert code == 5
    assert words is not None
    assert (words.memory, words.final) == (True, False)
    assert words.message.startswith("sim-0 ran out of memory: it uses ")
    assert "DR_WORKERS" in words.remedy


def test_a_worker_has_a_pulse_from_its_start(job):
    from drcli.records.heartbeat import HeartbeatRecord

    script = """
import time
from drcli.workers import worker_process as process

def main(job, stop_signal):
    time.sleep(0.3)

process.run("sim-0", main)
"""
    assert ended(job, script)[0] == 0

    heartbeat = HeartbeatRecord.read(job.folder, "sim-0")
    assert heartbeat is not None
    assert (heartbeat.activity, heartbeat.work) == ("starting", 0)
