"""One working folder for all examples of a test process."""

from collections.abc import Iterator

import pytest

from fuzz_space import FuzzSpace


@pytest.fixture(scope="session")
def space(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FuzzSpace]:
    """A working folder with a trained model; `restore` makes it new."""
    made = FuzzSpace(tmp_path_factory.mktemp("fuzz"))
    yield made
    made.close()
