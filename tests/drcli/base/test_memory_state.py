"""How much memory there is, by the files of Linux."""

from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

from drcli.base.memory import read_memory

GB = 1 << 30


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine of 16 GB, 10 of them free, with these files of Linux."""
    memory = SimpleNamespace(total=16 * GB, available=10 * GB)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: memory)
    monkeypatch.setattr(psutil, "swap_memory", lambda: SimpleNamespace(total=0, free=0))

    def make(**files: str) -> Path:
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return tmp_path

    return make


def test_without_groups_the_machine_counts(machine):
    state = read_memory(machine())

    assert (state.total_bytes, state.available_bytes) == (16 * GB, 10 * GB)
    assert (state.limited, state.kills) == (False, 0)


def test_the_limit_of_a_container_counts_without_what_can_be_given_back(machine):
    state = read_memory(
        machine(
            **{
                "proc/self/cgroup": "0::/\n",
                "sys/fs/cgroup/memory.max": str(2 * GB),
                "sys/fs/cgroup/memory.current": str(GB + GB // 2),
                "sys/fs/cgroup/memory.stat": f"anon {GB}\ninactive_file {GB // 4}\n",
                "sys/fs/cgroup/memory.events": "low 0\noom 3\noom_kill 2\n",
            }
        )
    )

    assert (state.total_bytes, state.available_bytes) == (2 * GB, 3 * GB // 4)
    assert (state.limited, state.kills) == (True, 2)


def test_the_limits_of_older_systems_count(machine):
    state = read_memory(
        machine(
            **{
                "proc/self/cgroup": "9:memory:/docker/abc\n0::/\n",
                "sys/fs/cgroup/memory/memory.limit_in_bytes": str(GB),
                "sys/fs/cgroup/memory/memory.usage_in_bytes": str(GB // 2),
                "sys/fs/cgroup/memory/memory.oom_control": "oom_kill_disable 0\noom_kill 1\n",
            }
        )
    )

    assert (state.total_bytes, state.available_bytes, state.kills) == (GB, GB // 2, 1)


@pytest.mark.parametrize(
    "files",
    [
        {"sys/fs/cgroup/memory.max": "max\n", "sys/fs/cgroup/memory.current": "5\n"},
        {"sys/fs/cgroup/memory.max": "word\n", "sys/fs/cgroup/memory.current": "5\n"},
        {"sys/fs/cgroup/memory.max": "100\n"},
        {
            "proc/self/cgroup": "4:memory:/\n",
            "sys/fs/cgroup/memory/memory.limit_in_bytes": "9223372036854771712\n",
            "sys/fs/cgroup/memory/memory.usage_in_bytes": "5\n",
        },
    ],
)
def test_a_group_without_a_limit_does_not_count(machine, files):
    state = read_memory(machine(**{"proc/self/cgroup": "0::/\n", **files}))

    assert not state.limited


def test_kills_of_the_machine_count_where_the_group_counts_none(machine):
    state = read_memory(machine(**{"proc/vmstat": "pgfault 7\noom_kill 4\n"}))

    assert state.kills == 4


def test_this_machine_has_memory():
    state = read_memory()

    assert 0 < state.available_bytes <= state.total_bytes
