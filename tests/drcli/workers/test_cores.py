"""How many cores a process counts with."""

import os
from pathlib import Path

import pytest

from drcli.config.loading import load_settings
from drcli.workers.cores import cores, driving_threads, learning_threads, overlaps, usable_cores


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine of 8 cores, with these files of Linux."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)

    def make(**files: str) -> Path:
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return tmp_path

    return make


def test_without_limits_all_cores_that_it_may_run_on_count(machine, monkeypatch):
    root = machine(**{"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/cpu.max": "max 100000\n"})

    assert cores(root) == 8
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3})
    assert cores(root) == 1


@pytest.mark.parametrize(
    ("quota", "count"),
    [("200000 100000", 2), ("150000 100000", 2), ("20000 100000", 1), ("1600000 100000", 8)],
)
def test_the_limit_of_a_container_counts(machine, quota, count):
    root = machine(**{"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/cpu.max": quota})

    assert cores(root) == count


def test_the_smallest_limit_of_all_groups_above_counts(machine):
    root = machine(
        **{
            "proc/self/cgroup": "0::/user.slice/racing.service\n",
            "sys/fs/cgroup/user.slice/cpu.max": "300000 100000",
            "sys/fs/cgroup/user.slice/racing.service/cpu.max": "max 100000",
        }
    )

    assert cores(root) == 3


@pytest.mark.parametrize(("quota", "count"), [("250000", 3), ("-1", 8)])
def test_the_limits_of_older_systems_count(machine, quota, count):
    root = machine(
        **{
            "proc/self/cgroup": "4:memory:/\n3:cpu,cpuacct:/docker/abc\n0::/\n",
            "sys/fs/cgroup/cpu,cpuacct/cpu.cfs_quota_us": quota,
            "sys/fs/cgroup/cpu,cpuacct/cpu.cfs_period_us": "100000",
        }
    )

    assert cores(root) == count


@pytest.mark.parametrize("text", ["", "abc", "0 0", "max"])
def test_files_that_say_something_else_limit_nothing(machine, text):
    root = machine(**{"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/cpu.max": text})

    assert cores(root) == 8


@pytest.mark.parametrize(
    ("threads", "usable", "overlap", "learning", "driving"),
    [("0", 8, True, 4, 4), ("2", 2, False, 2, 2), ("4", 4, True, 2, 2), ("16", 8, True, 4, 4)],
)
def test_a_limit_of_the_racer_counts_for_trainer_and_workers(
    machine, tmp_path, monkeypatch, threads, usable, overlap, learning, driving
):
    # 001-51, 001-52
    monkeypatch.setattr("drcli.workers.cores.ROOT", machine())
    (tmp_path / "run.env").write_text(f"DR_THREADS={threads}\n")
    train = load_settings(tmp_path, environ={}).run.train

    assert usable_cores(train) == usable
    assert overlaps(train) is overlap
    assert (learning_threads(train), driving_threads(train)) == (learning, driving)
