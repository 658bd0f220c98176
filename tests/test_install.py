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


def test_new_locked_versions_are_installed(clone):
    environment = {**os.environ, "PYTHON": sys.executable}
    subprocess.run([clone / "scripts" / "install.sh"], check=True, env=environment)
    before = (clone / ".venv" / ".installed-base").stat().st_mtime

    os.utime(clone / "constraints" / "default.txt", (before + 1, before + 1))
    subprocess.run([clone / "scripts" / "install.sh"], check=True, env=environment)

    assert len((clone / "asked.txt").read_text().splitlines()) == 4
