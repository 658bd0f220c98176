"""How all tests run: no threads that wait busily for each other, and the same examples always."""

import os
import sys

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


BEGINNING = ["test_training.py", "test_shells.py", "test_screens.py"]
"""End-to-end tests that come first. One process of the tests has numba compile the simulation, and
the other ones, which would otherwise compile it too, have something else to do meanwhile."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes long comes first, so that no process works alone in the end."""
    items.sort(key=_place)


def _place(item: pytest.Item) -> int:
    if item.path.parent.name != "e2e":
        return len(BEGINNING) + 1
    return BEGINNING.index(item.path.name) if item.path.name in BEGINNING else len(BEGINNING)
