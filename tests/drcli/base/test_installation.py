"""Libraries that are missing, too old or broken, in an environment that lacks parts of this one."""

import os
import re
import shlex
import subprocess
import sys
import threading
import venv
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from drcli.base import installation
from drcli.base.errors import NotAvailable

ROOT = Path(__file__).resolve().parents[3]
[HERE] = {Path(metadata.distribution(name).locate_file("")) for name in ("mujoco", "numba")}


@pytest.fixture
def environment(tmp_path):
    """Makes an environment with links to the packages of this one, except those named so."""

    def make(*absent: str) -> Path:
        venv.create(tmp_path / "venv", with_pip=False)
        [packages] = (tmp_path / "venv" / "lib").glob("python3*/site-packages")
        for place in HERE.iterdir():
            if place.name not in absent and not place.name.startswith("_editable"):
                (packages / place.name).symlink_to(place)
        (packages / "drcli.pth").write_text(f"{ROOT}\n{ROOT / 'env'}\n", "utf-8")
        return packages

    return make


def dr(packages: Path, *words: str) -> tuple[int, str]:
    python = packages.parents[2] / "bin" / "python"
    folder = packages.parents[3] / "work"
    folder.mkdir(exist_ok=True)
    call = "import sys; from drcli.cli.program import main; sys.argv[0] = 'dr'; main()"
    done = subprocess.run(
        [python, "-P", "-c", call, *words],
        cwd=folder,
        env={**os.environ, "DR_LOCAL_S3_ENGINE": "moto"},
        capture_output=True,
        text=True,
    )
    return done.returncode, done.stderr


@pytest.mark.nightly
@pytest.mark.parametrize("command", ["tracks show reinvent_base", "validate"])
def test_mujoco_after_an_upgrade_from_version_3_is_named_with_what_mends_it(environment, command):
    packages = environment("mujoco")
    # What pip leaves: of the new version, the files of the packages that it installed after it
    # removed those of the old one.
    left = {file.locate() for file in metadata.files("mujoco") if file.parts[0] == "mujoco"}
    for file in left:
        copy = packages / Path(file).relative_to(HERE)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.symlink_to(file)
    if command != "validate":  # which would start the S3 server
        folder = packages.parents[3] / "work"
        folder.mkdir()
        (folder / "run.env").touch()

    code, said = dr(packages, *command.split())

    assert code == 7
    assert "mujoco cannot be imported, because files of it are missing" in said
    assert "install --force-reinstall --no-deps mujoco==" in said
    assert " mujoco-core==" in said
    assert "Internal error" not in said


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("absent", "command", "words"),
    [
        ("typer", "status", "typer cannot be imported, because files of it are missing"),
        ("llvmlite", "validate", "llvmlite cannot be imported, because files of it are missing"),
    ],
)
def test_a_library_whose_files_are_gone_is_named_by_every_command(
    environment, absent, command, words
):
    packages = environment(absent)

    code, said = dr(packages, command)

    assert code == 7
    assert words in said
    assert f"--force-reinstall --no-deps {absent}=={metadata.version(absent)}" in said


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("numpy>=99", "numpy is .*, older than 99"),
        ("torch==1.0", "torch is .*, not 1.0"),
        ("no-such-package>=1.2", "no-such-package is not installed"),
    ],
)
def test_what_is_missing_or_too_old_is_completed_by_pip(monkeypatch, line, words):
    monkeypatch.setattr(installation.metadata, "requires", lambda _: [line, "old; extra == 'x'"])

    error = installation.installation_error()

    assert error is not None
    assert error.code == 7
    assert re.search(words, str(error))
    assert f"{shlex.quote(sys.executable)} -m pip install drcli" in error.remedy


def test_everything_that_drcli_requires_can_be_imported_here():
    names = [Requirement(line).name for line in metadata.requires("drcli") if ";" not in line]

    assert len(names) > 20
    assert installation.installation_error() is None


def test_an_import_of_our_own_that_fails_is_a_bug_and_no_matter_of_the_installation():
    with pytest.raises(ImportError) as failed:
        exec("from drcli.base.installation import there_is_no_such_name")

    assert installation.import_error(failed.value) is None


def test_a_version_that_fits_no_other_is_told_with_its_own_words(tmp_path, monkeypatch):
    (tmp_path / "choosy.py").write_text('raise ImportError("Choosy needs Picky 2 or less.")')
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ImportError) as failed:
        __import__("choosy")

    error = installation.import_error(failed.value)

    assert str(error) == "choosy cannot be imported: Choosy needs Picky 2 or less."
    assert "in a new environment" in error.remedy


def test_a_lazy_import_loads_a_module_when_something_of_it_is_used(tmp_path, monkeypatch):
    package = tmp_path / "slow_package"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "part.py").write_text("VALUE = 7\n")
    monkeypatch.syspath_prepend(tmp_path)

    with installation.lazy_imports():
        import slow_package as whole
        from slow_package import part

    assert "slow_package" not in sys.modules
    assert part.VALUE == 7
    assert whole.part is sys.modules["slow_package.part"]


def test_an_import_of_another_thread_is_not_delayed(tmp_path, monkeypatch):
    (tmp_path / "eager_module.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)

    with installation.lazy_imports():
        thread = threading.Thread(target=exec, args=("import eager_module",))
        thread.start()
        thread.join()

    assert "eager_module" in sys.modules


def test_a_lazy_library_that_is_missing_names_its_extra(monkeypatch):
    monkeypatch.setattr(installation, "is_installed", lambda name: False)
    with installation.lazy_imports():
        import pandas

    with pytest.raises(NotAvailable) as raised:
        pandas.DataFrame()

    assert raised.value.remedy == 'Install it with `pip install "drcli[analysis]"`.'
