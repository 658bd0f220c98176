"""Where compiled loops are kept, on machines where little can be written."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

MODULE = """
from drsim.jit import kernel

@kernel
def twice(number):
    return 2 * number

print(twice(21))
"""


@pytest.fixture
def run(tmp_path):
    """A module with a kernel beside which nothing can be written, by a user without a home."""
    (tmp_path / "module.py").write_text(MODULE)
    (tmp_path / "__pycache__").write_text("a file where numba wants a folder, for root as well")
    (tmp_path / "scratch").mkdir()

    def start(**variables: str) -> str:
        known = {"PATH": os.environ["PATH"], "TMPDIR": str(tmp_path / "scratch")}
        done = subprocess.run(
            [sys.executable, str(tmp_path / "module.py")],
            env={**known, "HOME": "/dev/null", **variables},
            cwd=tmp_path / "scratch",
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.stdout == "42\n", done.stderr
        return done.stderr

    return start


@pytest.fixture
def kept(tmp_path) -> Path:
    """Where compiled code of this user is kept when all else fails."""
    return tmp_path / "scratch" / f"drsim-kernels-{os.getuid()}"


def test_without_a_writable_home_or_installation_code_is_kept_below_the_temporary_folder(run, kept):
    assert run() == ""

    assert [file.suffix for file in sorted(kept.rglob("*.nb*"))] == [".nbc", ".nbi"]
    assert kept.stat().st_mode & 0o777 == 0o700


def test_no_code_is_taken_from_a_folder_that_others_can_write_to(run, kept):
    kept.mkdir()
    kept.chmod(0o777)

    assert run() == ""

    assert not list(kept.iterdir())


def test_the_folder_that_the_user_names_comes_first(run, kept, tmp_path):
    run(NUMBA_CACHE_DIR=str(tmp_path / "named"))

    assert list((tmp_path / "named").rglob("*.nbi"))
    assert not kept.exists()


def test_a_named_folder_that_cannot_be_written_stops_nobody(run, kept):
    run(NUMBA_CACHE_DIR="/dev/null/cache")

    assert list(kept.rglob("*.nbi"))
