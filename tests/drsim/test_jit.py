"""Where compiled loops are kept where little can be written, and what they may use."""

import ast
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import numba
import numpy as np
import pytest

import drsim
from drsim.jit import kernel, prefetch, take_number

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


@pytest.mark.nightly
def test_without_a_writable_home_or_installation_code_is_kept_below_the_temporary_folder(run, kept):
    assert run() == ""

    assert [file.suffix for file in sorted(kept.rglob("*.nb*"))] == [".nbc", ".nbi"]
    assert kept.stat().st_mode & 0o777 == 0o700


@pytest.mark.nightly
def test_no_code_is_taken_from_a_folder_that_others_can_write_to(run, kept):
    kept.mkdir()
    kept.chmod(0o777)

    assert run() == ""

    assert not list(kept.iterdir())


@pytest.mark.nightly
def test_the_folder_that_the_user_names_comes_first(run, kept, tmp_path):
    run(NUMBA_CACHE_DIR=str(tmp_path / "named"))

    assert list((tmp_path / "named").rglob("*.nbi"))
    assert not kept.exists()


@pytest.mark.nightly
def test_a_named_folder_that_cannot_be_written_stops_nobody(run, kept):
    run(NUMBA_CACHE_DIR="/dev/null/cache")

    assert list(kept.rglob("*.nbi"))


def test_a_kernel_asks_the_memory_for_an_element_without_changing_it():
    @numba.njit  # not cached, because cached code cannot be looked at
    def asked_and_read(numbers, index):
        prefetch(numbers, np.uint32(index))
        return numbers[index]

    numbers = np.arange(10, dtype=np.uint32)[::2]

    assert asked_and_read(numbers, 3) == 6

    (code,) = asked_and_read.inspect_llvm().values()
    assert "call void @llvm.prefetch" in code


@kernel
def take_all(counter, mine):
    while True:
        number = take_number(counter)
        if number >= len(mine):
            break
        mine[number] += 1


def test_threads_that_share_a_counter_take_each_number_once():
    counter, taken = np.zeros(1, np.int64), np.zeros(200_000, np.int64)
    take_all(np.zeros(1, np.int64), np.zeros(0, np.int64))  # compiles

    threads = [threading.Thread(target=take_all, args=(counter, taken)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert (taken == 1).all()
    assert counter[0] == len(taken) + len(threads)


def files_with_kernels() -> list[Path]:
    files = Path(drsim.__file__).parent.rglob("*.py")
    return sorted(file for file in files if "@kernel" in file.read_text(encoding="utf-8"))


@pytest.mark.parametrize("file", files_with_kernels(), ids=lambda file: file.stem)
def test_a_kernel_uses_nothing_of_another_file(file):
    foreign = foreign_names(ast.parse(file.read_text(encoding="utf-8")))

    assert not foreign, "the cache would not notice a change there; hand them over as arguments"


@pytest.mark.parametrize(
    "line",
    [
        "def f(x): return x + FAR",
        "def f(x): return x + TWICE",
        "def f(x): return x + FOUR_TIMES",
        "def f(x: Record): return x",
        "def f(x: 'Record'): return x",
        "def f(x): return track.width(x)",
        "def f(x): return Own(x)",
    ],
)
def test_what_a_kernel_uses_of_another_file_is_found(line):
    module = f"""
from drsim.jit import kernel
from drsim.arrays import Floats
from drsim.car import FAR, Record
import drsim.track as track
TWICE = 2 * FAR
FOUR_TIMES: float = 2 * TWICE
OWN = 3.0
class Own(NamedTuple):
    record: Record
@kernel
def fine(FAR: Floats):
    return FAR + OWN
@kernel
{line}
"""
    assert [kernel for kernel, _ in foreign_names(ast.parse(module))] == ["f"]


def foreign_names(module: ast.Module) -> list[tuple[str, str]]:
    """Each kernel with a name in it that comes from another file of drsim, directly or not."""
    foreign = set()
    for node in ast.walk(module):
        if isinstance(node, ast.ImportFrom) and (node.level or is_foreign(node.module or "")):
            foreign |= {alias.asname or alias.name for alias in node.names}
        if isinstance(node, ast.Import):
            names = [alias for alias in node.names if is_foreign(alias.name)]
            foreign |= {alias.asname or alias.name.partition(".")[0] for alias in names}
    defined = [(names_bound(node), names_used(node)) for node in module.body]
    while more := {name for bound, used in defined if used & foreign for name in bound - foreign}:
        foreign |= more
    # A kernel that calls one with a foreign name is named by that one.
    return [
        (node.name, name)
        for node in module.body
        if isinstance(node, ast.FunctionDef) and is_kernel(node)
        for name in sorted(names_used(node) & foreign)
    ]


def is_foreign(module: str) -> bool:
    return module.partition(".")[0] == "drsim" and module not in ("drsim.jit", "drsim.arrays")


def is_kernel(node: ast.FunctionDef) -> bool:
    return any(isinstance(d, ast.Name) and d.id == "kernel" for d in node.decorator_list)


def names_bound(node: ast.stmt) -> set[str]:
    """Names that a statement of a module gives a value, kernels aside."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        kernel = isinstance(node, ast.FunctionDef) and is_kernel(node)
        return set() if kernel else {node.name}
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and is_stored(n)}


def names_used(node: ast.stmt) -> set[str]:
    """Names of the module that a statement uses, in annotations, too."""
    used, own = set(), set()
    for part in ast.walk(node):
        if isinstance(part, ast.Name):
            (own if is_stored(part) else used).add(part.id)
        elif isinstance(part, ast.arg):
            own.add(part.arg)
            if isinstance(part.annotation, ast.Constant):
                used |= set(re.findall(r"\w+", str(part.annotation.value)))
    return used - own


def is_stored(name: ast.Name) -> bool:
    return isinstance(name.ctx, ast.Store)


def test_numba_knows_that_scipy_is_there_without_loading_its_algebra():
    asks = (
        "from drsim.jit import get_ready; get_ready(); import sys; from numba.np import arraymath"
    )
    told = "print(arraymath._HAVE_BLAS, 'scipy.linalg' in sys.modules)"

    done = subprocess.run([sys.executable, "-c", f"{asks}; {told}"], capture_output=True, text=True)

    assert done.stdout == "True False\n", done.stderr
