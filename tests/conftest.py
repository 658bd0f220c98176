"""How all tests run: no threads that wait busily for each other, and the same examples always."""

import importlib.util
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# Torch reads it when it is loaded. Its threads spin while they wait, so on a busy machine a test
# of ten small gradient steps took twenty seconds instead of one.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Some tests write each example over the last one's file, in a folder that all of them share.
SUPPRESSED = [HealthCheck.too_slow, HealthCheck.function_scoped_fixture]

# A busy machine makes slow examples, which says nothing about the code; and what CI tries on one
# day it must try on every day, or a red run cannot be looked into.
settings.register_profile(
    "drcli", deadline=None, derandomize=True, suppress_health_check=SUPPRESSED
)
settings.load_profile("drcli")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes long comes first, so that no process works alone in the end."""
    items.sort(key=lambda item: item.path.parent.name != "e2e")


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
