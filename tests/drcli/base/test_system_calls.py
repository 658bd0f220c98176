"""Calls that not every system has, and what happens without them (001-06)."""

import ast
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drcli.base import clock, processes, system_calls
from drcli.base.errors import NotAvailable
from drcli.checks.doctor import surroundings
from drcli.run.memory_watch import open_files_limit
from drcli.workers import heartbeat_thread

ROOT = Path(__file__).resolve().parents[3]
OTHER_SYSTEM = ROOT / "tests" / "support" / "other_system"

NATIVE_MODULES = {"fcntl", "resource", "termios", "pty", "pwd", "grp", "msvcrt", "winreg"}

LINUX_ONLY = {
    *("sched_getaffinity", "sched_setaffinity", "pidfd_open", "memfd_create", "eventfd"),
    *("posix_fadvise", "posix_fallocate", "copy_file_range", "getxattr", "setxattr", "splice"),
    *("O_TMPFILE", "O_DIRECT", "O_PATH", "epoll", "prlimit", "RUSAGE_THREAD", "prctl"),
    *("pidfd_send_signal", "sigtimedwait", "sigwaitinfo", "SIGPWR", "SIGSTKFLT", "SIGRTMIN"),
    *("CLOCK_BOOTTIME", "getrandom", "unshare", "setns", "AF_NETLINK", "SO_PEERCRED"),
}
"""Names of Python's modules that exist on Linux and not on macOS. Source: their documentation."""

ALLOWED = {
    "drcli/base/system_calls.py",  # each function has a fallback
    "drcli/base/clock.py",  # chooses a clock
    "drcli/base/confinement.py",  # guards the call only where it exists
    "drcli/config/secret_environment.py",  # returns at once on other systems
    "drcli/train/learner_group.py",  # only where there is /dev/shm
}


def sources() -> list[Path]:
    """Every module of ours that a racer runs."""
    return [*(ROOT / "drcli").rglob("*.py"), *(ROOT / "env" / "drsim").rglob("*.py")]


def test_only_one_module_calls_the_system_directly():
    native, linux = set(), set()
    for path in sources():
        place, text = path.relative_to(ROOT).as_posix(), path.read_text("utf-8")
        if not any(word in text for word in NATIVE_MODULES | LINUX_ONLY):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                names = {alias.name.split(".")[0] for alias in node.names}
            else:
                names = {node.module} if isinstance(node, ast.ImportFrom) else set()
            native |= {place} if names & NATIVE_MODULES else set()
            linux |= (
                {place} if isinstance(node, ast.Attribute) and node.attr in LINUX_ONLY else set()
            )

    assert native == {"drcli/base/system_calls.py"}
    assert linux <= ALLOWED


def test_a_shared_lock_excludes_only_a_lock_that_is_not_shared(tmp_path):
    files = [os.open(tmp_path / "lock", os.O_RDWR | os.O_CREAT) for _ in range(3)]
    try:
        assert system_calls.try_lock(files[0], shared=True)
        assert system_calls.try_lock(files[1], shared=True)
        assert not system_calls.try_lock(files[2])
        os.close(files.pop(0))
        os.close(files.pop(0))
        assert system_calls.try_lock(files[0])
    finally:
        for descriptor in files:
            os.close(descriptor)


def test_a_system_without_locks_is_refused_with_the_one_that_it_has(tmp_path, monkeypatch):
    monkeypatch.setattr(system_calls, "fcntl", None)
    with (tmp_path / "lock").open("w") as file, pytest.raises(NotAvailable, match="WSL") as refusal:
        system_calls.try_lock(file.fileno())

    assert refusal.value.code == 7


def test_without_the_module_of_limits_nothing_is_limited(monkeypatch):
    monkeypatch.setattr(system_calls, "resource", None)

    assert system_calls.soft_limit("open_files") is None
    assert open_files_limit() == 0
    assert not system_calls.limit_data(1 << 30)
    findings = list(surroundings.examine_limits())
    assert [finding.state for finding in findings] == ["ok"]


class Limits:
    """The module `resource` of a system."""

    RLIM_INFINITY = (1 << 63) - 1
    RLIMIT_NOFILE, RLIMIT_DATA = 1, 2

    def getrlimit(self, _kind: int) -> tuple[int, int]:
        return self.RLIM_INFINITY - 1, self.RLIM_INFINITY

    def setrlimit(self, _kind: int, _limits: tuple[int, int]) -> None:
        raise ValueError("current limit exceeds maximum limit")


def test_limits_of_macos_are_read_and_a_refused_one_stops_nothing(monkeypatch):
    monkeypatch.setattr(system_calls, "resource", Limits())

    assert system_calls.soft_limit("open_files") is None
    assert system_calls.soft_limit("memory") is None
    assert not system_calls.limit_data(1 << 30)


def test_cores_open_files_and_clock_have_another_source_elsewhere(monkeypatch, tmp_path):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.delattr(time, "CLOCK_BOOTTIME", raising=False)
    monkeypatch.setattr(system_calls, "_DESCRIPTORS", (tmp_path / "absent", Path("/dev/fd")))

    assert system_calls.cores_of_process() == os.cpu_count()
    assert system_calls.open_files() >= 3
    assert clock.elapsed_s() == pytest.approx(time.monotonic(), abs=1.0)
    monkeypatch.setattr(system_calls, "_DESCRIPTORS", (tmp_path / "absent",))
    assert system_calls.open_files() == 0


def test_processes_are_recognised_without_proc(monkeypatch, tmp_path):
    monkeypatch.setattr(processes, "_PROC", tmp_path / "absent")
    processes.this_machine.cache_clear()
    try:
        name = processes.this_machine()
    finally:
        processes.this_machine.cache_clear()
    began_s = processes.started_s(os.getpid())

    assert name.startswith("booted ")
    assert began_s is not None
    assert processes.is_alive(os.getpid(), began_s)
    assert not processes.is_alive(os.getpid(), began_s - 100.0)
    assert heartbeat_thread.own_memory_bytes() > 1 << 20


@pytest.mark.parametrize("linux", [True, False])
def test_the_wait_for_a_process_ends_with_it_or_with_the_time(monkeypatch, linux):
    if not linux:
        monkeypatch.delattr(os, "pidfd_open", raising=False)
    elif not hasattr(os, "pidfd_open"):
        pytest.skip("this system cannot wait for processes of others")
    process = subprocess.Popen([sys.executable, "-S", "-c", ""])
    wait = system_calls.ExitWait(process.pid)
    before_s = time.monotonic()
    wait.wait(60.0 if linux else 0.01)
    wait.close()

    assert time.monotonic() - before_s < 30.0
    process.wait()


def test_a_command_runs_where_python_has_nothing_of_linux(tmp_path):
    # Whole trainings were tried by hand in the same way: docs/platforms.md.
    probe = (
        "import os, pathlib, sys\n"
        "assert not hasattr(os, 'sched_getaffinity') and not pathlib.Path('/proc').exists()\n"
        "from drcli.base import clock, memory, processes, system_calls\n"
        "assert processes.this_machine().startswith('booted ')\n"
        "assert processes.exists(os.getpid()) and memory.read_memory().total_bytes\n"
        "assert system_calls.open_files() and system_calls.cores_of_process()\n"
        "assert clock.elapsed_s()\n"
        "from drcli.cli.program import main\n"
        "sys.argv = ['dr', 'init', '-f', '--json']\n"
        "main()\n"
    )

    answer = subprocess.run(
        [sys.executable, "-c", probe],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(OTHER_SYSTEM), "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )

    assert answer.returncode == 0, answer.stderr
    assert json.loads(answer.stdout.splitlines()[-1])
    assert (tmp_path / "run.env").exists()


def test_native_windows_is_told_about_wsl_in_one_sentence():
    script = "import os; os.name = 'nt'; from drcli.cli.program import main; main()"
    answer = subprocess.run(
        [sys.executable, "-S", "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r}); {script}"],
        capture_output=True,
        text=True,
        check=False,
    )

    assert answer.returncode == 7
    assert "WSL" in answer.stderr
    assert "Traceback" not in answer.stderr
