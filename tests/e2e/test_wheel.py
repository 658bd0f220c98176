"""The wheel is all a user needs: it holds every data file and trains from an empty folder."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder)]
    subprocess.run([*command, str(ROOT)], check=True, capture_output=True, timeout=120)
    return next(folder.glob("*.whl"))


def test_the_wheel_holds_the_simulation_its_data_and_the_examples(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())

    assert {
        "drsim/episode/simulation.py",
        "drsim/car/car.xml",
        "drsim/track/definitions/reinvent_base.json",
        "drsim/py.typed",
        "drcli/py.typed",
        "drcli/_defaults/reward_function.py",
        "drcli/_defaults/hyperparameters.json",
        "drcli/_defaults/model_metadata.json",
        "drcli/_defaults/run.env",
        "drcli/_defaults/system.env",
        "drcli/_defaults/activate.sh",
    } <= names
    assert not [name for name in names if name.startswith(("env/", "tests/", "scripts/"))]


def test_an_installed_wheel_trains_an_iteration_in_an_empty_folder(wheel, tmp_path):
    python = _install(wheel, tmp_path / "venv")
    dr = python.parent / "dr"
    folder = tmp_path / "racer"
    folder.mkdir()
    (folder / "run.env").write_text("DR_WORLD_NAME=reinvent_base\nDR_TRAIN_MIN_EVAL_TRIALS=1\n")
    (folder / "system.env").write_text("DR_CLOUD=local\n")
    shipped = next(python.parents[1].glob("lib/*/site-packages/drcli/_defaults"))
    shutil.copytree(shipped, folder / "custom_files")
    hyperparameters = folder / "custom_files" / "hyperparameters.json"
    values = json.loads(hyperparameters.read_text())
    hyperparameters.write_text(json.dumps({**values, "term_cond_max_episodes": 1}))

    version = _run(dr, "--version", folder=folder)
    _run(dr, "start-training", folder=folder)
    status = json.loads(_run(dr, "status", "--json", folder=folder).splitlines()[-1])

    assert version.startswith("dr ")
    assert status["state"] == "finished"
    assert [record["episodes"] for record in status["history"]] == [20]
    stop = "from drcli.config.loading import load_settings as s; "
    stop += "from drcli.bucket.server import server; "
    stop += "from pathlib import Path; server.stop(s(Path.cwd()).storage)"
    subprocess.run([str(python), "-c", stop], cwd=folder, check=True)


def _install(wheel: Path, folder: Path) -> Path:
    """A new environment with the wheel in it.

    The wheel's dependencies are borrowed from the environment that runs the tests: downloading a
    gigabyte again would prove nothing about the wheel. An editable install of this checkout is
    left behind, because its path file is not read from there.
    """
    venv.create(folder, with_pip=False)
    python = folder / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python)]
    subprocess.run(
        [*pip, "install", "--quiet", "--no-deps", str(wheel)],
        check=True,
        timeout=120,
    )
    target = Path(
        subprocess.run(
            [str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
            check=True,
            capture_output=True,
            text=True,
        ).stdout.strip()
    )
    borrowed = "import sys; sys.path.append({!r})".format(sysconfig.get_path("purelib"))
    (target / "borrowed.pth").write_text(borrowed + "\n")
    _lend_compiled_code(target / "drsim")
    for program in Path(sysconfig.get_path("scripts")).glob("rclone*"):
        (folder / "bin" / program.name).symlink_to(program)
    return python


def _lend_compiled_code(installed: Path) -> None:
    """Put the machine code beside the modules that numba made of the same modules here.

    Numba and Python take what was compiled if the module is as old and as long as it was then.
    """
    here = ROOT / "env" / "drsim"
    for module in here.rglob("*.py"):
        copy = installed / module.relative_to(here)
        assert copy.read_bytes() == module.read_bytes()
        os.utime(copy, ns=(module.stat().st_atime_ns, module.stat().st_mtime_ns))
    for compiled in here.rglob("__pycache__"):
        shutil.copytree(compiled, installed / compiled.relative_to(here), dirs_exist_ok=True)


def _run(program: Path, *arguments: str, folder: Path) -> str:
    done = subprocess.run(
        [str(program), *arguments],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
