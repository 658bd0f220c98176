"""How all tests run: which of them, no threads that wait busily, and the same examples always."""

import importlib.util
import os
import secrets
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from hypothesis import HealthCheck, settings

# Torch reads it when it is loaded. Its threads spin while they wait, so on a busy machine a test
# of ten small gradient steps took twenty seconds instead of one.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# The tests start hundreds of processes, each of which would compile all our modules for itself.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Some tests write each example over the last one's file, in a folder that all of them share.
SUPPRESSED = [HealthCheck.too_slow, HealthCheck.function_scoped_fixture]

# A busy machine makes slow examples, which says nothing about the code; and what CI tries on one
# day it must try on every day, or a red run cannot be looked into.
settings.register_profile(
    "drcli", deadline=None, derandomize=True, suppress_health_check=SUPPRESSED
)
settings.load_profile("drcli")


MARKER = "DRCLI_TEST_RUN"
os.environ.setdefault(MARKER, secrets.token_hex(8))
"""In the environment of all processes that a test run starts, those of its own workers too."""

LEAVE_S = 15.0
"""How long a process may take to leave that was told to by the last test."""

BEGINNING = ["test_training.py", "test_shells.py", "test_screens.py"]
"""End-to-end tests that come first. One process of the tests has numba compile the simulation, and
the other ones, which would otherwise compile it too, have something else to do meanwhile."""


EVERYTHING = "DRCLI_TEST_EVERYTHING"
"""In the environment of a run, and so of its worker processes, that leaves nothing out."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--all",
        action="store_true",
        help="also run what is marked as nightly; so does naming files or folders",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Tell the processes of xdist by their environment: folders are named to each of them."""
    if hasattr(config, "workerinput"):
        return
    named = config.args_source is pytest.Config.ArgsSource.ARGS
    os.environ[EVERYTHING] = "1" if named or config.getoption("all") else ""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what every commit need not run; what takes long comes first.

    Otherwise, one process would work alone in the end.
    """
    if not os.environ[EVERYTHING]:
        left_out = [item for item in items if item.get_closest_marker("nightly")]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("nightly")]
    items.sort(key=_place)


def _place(item: pytest.Item) -> int:
    if item.path.parent.name not in ("e2e", "faults"):
        return len(BEGINNING) + 1
    return BEGINNING.index(item.path.name) if item.path.name in BEGINNING else len(BEGINNING)


@pytest.fixture(scope="session")
def log_guru() -> Callable[[str], Any]:
    """Reads a simulation log as log-guru does."""
    path = Path(__file__).with_name("log_guru.py")
    spec = importlib.util.spec_from_file_location("log_guru", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.read


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail a run that leaves processes behind, and end them: a server takes 60 MB for each test."""
    if hasattr(session.config, "workerinput"):
        return  # the process that gave out the tests looks once, when all are done
    # pytest has no public name for it outside of fixtures.
    folder = session.config._tmp_path_factory.getbasetemp()
    _, left = psutil.wait_procs(left_over(os.environ[MARKER], folder), timeout=LEAVE_S)
    for process in left:
        with suppress(psutil.Error):
            print(f"\nA test has left process {process.pid}: {' '.join(process.cmdline())}")
            process.kill()
    if left:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def left_over(marker: str, folder: Path) -> list[psutil.Process]:
    """Processes that come from the test run of that marker, or are about files below a folder."""
    ours = {os.getpid(), *(parent.pid for parent in psutil.Process().parents())}
    return [p for p in psutil.process_iter() if p.pid not in ours and _is_from(p, marker, folder)]


def _is_from(process: psutil.Process, marker: str, folder: Path) -> bool:
    with suppress(psutil.Error):
        line = process.cmdline()
        if not line or any("multiprocessing" in argument for argument in line):
            return False  # it has ended, or ends with us
        places = [*line, process.cwd()]
        if any(f"{folder}{os.sep}" in f"{place}{os.sep}" for place in places):
            return True
        return process.environ().get(MARKER) == marker
    return False
