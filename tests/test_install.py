"""`scripts/install.sh`, with a pip that installs nothing."""

import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


PIP = """
import os, sys
from pathlib import Path
limits = [os.environ.get(name, "") for name in ("PIP_CONSTRAINT", "PIP_BUILD_CONSTRAINT")]
with Path("asked.txt").open("a") as file:
    print(*limits, *sys.argv[1:], file=file)
"""
"""Says what it was asked."""


@pytest.fixture
def clone(tmp_path) -> Path:
    """What the script needs of a clone, in a folder with a blank and an umlaut."""
    clone = tmp_path / "Müllers Wagen"
    for package in ("drcli", "env/drsim"):
        (clone / package).mkdir(parents=True)
    for module in ("base/errors", "base/installation"):
        (clone / "drcli" / "base").mkdir(exist_ok=True)
        shutil.copy(ROOT / "drcli" / f"{module}.py", clone / "drcli" / "base")
        (clone / package / "__init__.py").touch()
    shutil.copy(ROOT / "pyproject.toml", clone)
    shutil.copytree(ROOT / "constraints", clone / "constraints")
    shutil.copytree(ROOT / "scripts", clone / "scripts", ignore=shutil.ignore_patterns("*.py"))
    venv.create(clone / ".venv", with_pip=False)
    [packages] = (clone / ".venv" / "lib").glob("python3*/site-packages")
    (packages / "pip").mkdir()
    (packages / "pip" / "__main__.py").write_text(PIP)
    [torch] = re.findall(r"torch==([\d.]+)", (clone / "pyproject.toml").read_text("utf-8"))
    (packages / f"torch-{torch}.dist-info").mkdir()
    metadata = packages / f"torch-{torch}.dist-info" / "METADATA"
    metadata.write_text(f"Metadata-Version: 2.1\nName: torch\nVersion: {torch}\n")
    return clone


@pytest.mark.parametrize("locale", ["C", "C.UTF-8"])
def test_a_clone_in_any_folder_starts_in_any_locale(clone, locale):
    environment = {**os.environ, "PYTHON": sys.executable, "LC_ALL": locale}

    subprocess.run([clone / "scripts" / "install.sh"], check=True, env=environment)

    found = subprocess.run(
        [clone / ".venv" / "bin" / "python", "-c", "import drcli, drsim; print(drsim.__file__)"],
        env=environment,
        cwd="/",
        capture_output=True,
        check=False,
    )
    assert found.stderr == b""
    assert found.stdout.decode().strip() == str(clone / "env" / "drsim" / "__init__.py")


@pytest.mark.parametrize(
    ("extra", "lock"), [("", "default"), ("dev", "default"), ("rendering", "rendering")]
)
def test_every_package_has_its_locked_version(clone, extra, lock):
    environment = {**os.environ, "PYTHON": sys.executable}

    for _ in range(2):  # the second time there is nothing to do
        subprocess.run(
            [clone / "scripts" / "install.sh", *extra.split()], check=True, env=environment
        )

    wanted = f".[{extra or 'analysis,video,web'}]"
    file = f"constraints/{lock}.txt"
    asked = (clone / "asked.txt").read_text().splitlines()
    assert asked[0].split() == [*f"install --quiet --upgrade --constraint {file} pip".split()]
    assert asked[1].split() == [file, file, "install", "--quiet", "--editable", wanted]
    assert len(asked) == 2


def test_a_library_that_is_installed_but_broken_is_installed_again_or_ends_the_script(clone):
    [packages] = (clone / ".venv" / "lib").glob("python3*/site-packages")
    for name, lines in {"drcli": "Requires-Dist: pieces>=1\n", "pieces": ""}.items():
        (packages / f"{name}-1.0.dist-info").mkdir()
        head = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n{lines}"
        (packages / f"{name}-1.0.dist-info" / "METADATA").write_text(head)
    record = "pieces/__init__.py,,24\npieces/core.py,,0\npieces-1.0.dist-info/RECORD,,\n"
    (packages / "pieces-1.0.dist-info" / "RECORD").write_text(record)
    (packages / "pieces").mkdir()
    (packages / "pieces" / "__init__.py").write_text("from . import core as core\n"[:24])
    environment = {**os.environ, "PYTHON": sys.executable}
    install = [clone / "scripts" / "install.sh"]

    broken = subprocess.run(install, env=environment, capture_output=True, text=True)
    (packages / "pieces" / "core.py").touch()
    mended = subprocess.run(install, env=environment, capture_output=True, text=True)

    asked = (clone / "asked.txt").read_text().splitlines()
    assert asked[2].split()[1:] == [
        *["install", "--force-reinstall", "--no-deps", "pieces==1.0", "--quiet"]
    ]
    assert broken.returncode == 7
    assert "pieces cannot be imported" in broken.stderr
    assert mended.returncode == 0


def test_new_locked_versions_are_installed(clone):
    environment = {**os.environ, "PYTHON": sys.executable}
    subprocess.run([clone / "scripts" / "install.sh"], check=True, env=environment)
    before = (clone / ".venv" / ".installed-base").stat().st_mtime

    os.utime(clone / "constraints" / "default.txt", (before + 1, before + 1))
    subprocess.run([clone / "scripts" / "install.sh"], check=True, env=environment)

    assert len((clone / "asked.txt").read_text().splitlines()) == 4
