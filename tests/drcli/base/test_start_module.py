"""A module that is started as a program, with rare searches for garbage during its imports."""

import subprocess
import sys

PROGRAM = """
import gc
import sys
from drcli.base.processes import search_as_usual

print(__name__, sys.argv[1:], __file__.endswith("module_to_start.py"))
print(gc.get_threshold()[0] >= 50_000)
search_as_usual()
print(gc.get_threshold()[0] < 10_000, gc.get_freeze_count() > 1_000)
sys.exit(4)
"""


def test_the_module_is_a_program_that_searches_rarely_until_it_wants_to(tmp_path):
    (tmp_path / "module_to_start.py").write_text(PROGRAM)

    done = subprocess.run(
        [sys.executable, "-m", "drcli.base.start_module", "module_to_start", "3", "--last"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
    )

    assert done.returncode == 4, done.stderr
    assert done.stdout.splitlines() == ["__main__ ['3', '--last'] True", "True", "True True"]
    assert done.stderr == ""


def test_a_file_of_the_working_folder_does_not_replace_a_module(tmp_path):
    (tmp_path / "json.py").write_text("raise SystemExit('the wrong json')")
    (tmp_path / "runpy.py").write_text("raise SystemExit('the wrong runpy')")

    done = subprocess.run(
        [sys.executable, "-P", "-m", "drcli.base.start_module", "drcli.train.sim", "0"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        stdin=subprocess.DEVNULL,
    )

    assert done.returncode == 3
    assert "cannot read its job" in done.stderr
