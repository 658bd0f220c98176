"""docs/testing.md: what every commit runs, and what is left for the night."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
JOURNEYS = re.findall(
    r"^\| .* \| `(tests/e2e/\w+\.py)::(\w+)` \|$",
    (ROOT / "docs" / "testing.md").read_text("utf-8"),
    re.MULTILINE,
)


def test_there_are_eight():
    assert len(JOURNEYS) == 8


@pytest.mark.parametrize(("file", "name"), JOURNEYS)
def test_every_commit_runs_a_journey(file, name):
    tree = ast.parse((ROOT / file).read_text("utf-8"))

    [test] = [node for node in tree.body if getattr(node, "name", "") == name]
    assert isinstance(test, ast.FunctionDef)
    assert not [mark for mark in test.decorator_list if "nightly" in ast.unparse(mark)]
    assert "pytestmark" not in {
        target.id
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }


TWO_TESTS = """
import pytest

def test_of_every_commit():
    pass

@pytest.mark.nightly
def test_of_the_night():
    pass
"""


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("arguments", "passed"),
    [
        ("-n 1", "1 passed"),
        ("-n 1 --all", "2 passed"),
        ("-n 1 tests/test_two.py", "2 passed"),
    ],
)
def test_marked_tests_are_left_out_unless_all_are_wanted_or_files_are_named(
    tmp_path, arguments, passed
):
    folder = tmp_path / "tests"
    folder.mkdir()
    shutil.copy(ROOT / "tests" / "conftest.py", folder)
    (folder / "test_two.py").write_text(TWO_TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\ntestpaths = tests\nmarkers = nightly\n")

    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments.split()],
        cwd=tmp_path,
        env={
            **os.environ,
            "DRCLI_TEST_RUN": str(tmp_path),
            "PYTEST_ADDOPTS": "--basetemp=temporary",
        },
        capture_output=True,
        text=True,
        timeout=120,
    )

    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{passed} in " in done.stdout
