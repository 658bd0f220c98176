"""Files and environment that a machine needs."""

import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import drcli
from drcli.base.errors import SettingsError
from drcli.config.settings import Settings
from drcli.config.track_names import ROUTE_FILES, races_with_lists

OTS_FOLDER = "custom-files"
"""Of deepracer-on-the-spot, with all files of a user."""

MOST_TRACK_BYTES = 20_000_000

_WORKER_FILE = re.compile(r"worker-\d+\.env")


def lay_out(source: Path, folder: Path) -> None:
    """Make a working folder from one of deepracer-on-the-spot.

    Raises:
        SettingsError: There is no run.env, or a file is unreadable.
    """
    if not (source / "run.env").is_file():
        raise SettingsError(
            f"{source}: there is no run.env in this folder.",
            remedy="Name the folder with your run.env, system.env and reward_function.py.",
        )
    try:
        (folder / "custom_files").mkdir()
        for path in sorted(source.iterdir()):
            if path.suffix == ".env" and path.is_file():
                shutil.copyfile(path, folder / path.name)
            elif path.is_file():
                shutil.copyfile(path, folder / "custom_files" / path.name)
    except OSError as error:
        raise SettingsError(
            f"{error.filename or source}: cannot be copied ({error.strerror or error}).",
            remedy="Check the permissions of the file.",
        ) from error


def environment(bucket: str, region: str, stack: str, upload_bucket: str) -> dict[str, str]:
    """Variables of a training; they override its files."""
    found = {
        "DR_CLOUD": "aws",
        "DR_LOCAL_S3_BUCKET": bucket,
        # The role of the machine: this profile need not exist.
        "DR_LOCAL_S3_PROFILE": "default",
        "DR_UPLOAD_S3_PROFILE": "default",
        "DR_AWS_APP_REGION": region,
        "AWS_DEFAULT_REGION": region,
        # Names in files of deepracer-on-the-spot.
        "DEEPRACER_S3_URI": bucket,
        "DR_S3_URI": bucket,
        "MY_BUCKET": bucket,
        "DEEPRACER_REGION": region,
        "STACK_NAME": stack,
    }
    if upload_bucket in ("not-defined", ""):
        found["DR_UPLOAD_S3_BUCKET"] = bucket
    return found


def files_to_send(settings: Settings) -> dict[str, bytes]:
    """Settings and route files, by relative path.

    Raises:
        SettingsError: A file is unreadable, or the tracks are too large.
    """
    folder = settings.directory
    places = [folder]
    if settings.experiment_name:
        places.append(folder / "experiments" / settings.experiment_name)
    paths: dict[str, Path] = {}
    for place in places:
        for path in sorted(place.glob("*.env")) if place.is_dir() else []:
            if path.name in ("run.env", "system.env") or _WORKER_FILE.fullmatch(path.name):
                paths[path.relative_to(folder).as_posix()] = path
    worlds = {race.world_name for race in races_with_lists(settings.races)}
    tracks = settings.tracks_folder
    for path in sorted(tracks.iterdir()) if tracks.is_dir() else []:
        if path.suffix in ROUTE_FILES and {path.stem, path.name} & worlds:
            paths[f"tracks/{path.name}"] = path
    found = {}
    for name, path in paths.items():
        try:
            found[name] = path.read_bytes()
        except OSError as error:
            raise SettingsError(
                f"{path}: cannot be read ({error.strerror or error}).",
                remedy="Check the permissions of the file.",
            ) from error
    size = sum(len(data) for name, data in found.items() if name.startswith("tracks/"))
    if size > MOST_TRACK_BYTES:
        raise SettingsError(
            f"{tracks}: the tracks of this training take {size / 1e6:.0f} MB.",
            remedy=f"Use route files with less than {MOST_TRACK_BYTES / 1e6:.0f} MB together.",
        )
    return found


# Where a machine installs drcli from.


PACKAGES = ("python3-venv", "ca-certificates")
_BUILD_PATIENCE_S = 300.0


@dataclass(frozen=True)
class InstallSource:
    """What pip gets: a requirement, or a wheel."""

    requirement: str
    wheel: str = ""
    data: bytes = b""
    packages: tuple[str, ...] = PACKAGES

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.data).hexdigest() if self.wheel else ""

    @property
    def shown(self) -> str:
        return self.wheel or self.requirement


def find_source(wanted: str) -> InstallSource:
    """A wheel, URL or requirement; empty means the running drcli.

    Raises:
        SettingsError: The wheel is missing or cannot be built.
    """
    if not wanted:
        checkout = Path(drcli.__file__).resolve().parents[1]
        if (checkout / "pyproject.toml").is_file():
            return _built(checkout)
        return InstallSource(f"drcli=={drcli.__version__}")
    if wanted.endswith(".whl"):
        return _read(Path(wanted))
    if wanted.startswith("git+"):
        return InstallSource(wanted, packages=(*PACKAGES, "git"))
    if wanted.startswith("-") or any(letter.isspace() for letter in wanted):
        raise SettingsError(
            f"'{wanted[:80]}' is not something that pip can install (--install).",
            remedy="Name a .whl file, git+https://..., or a requirement such as drcli==1.2.",
        )
    return InstallSource(wanted)


def torch_requirement() -> str:
    try:
        needed = requires("drcli") or []
    except PackageNotFoundError:
        needed = []
    exact = (line.partition(";")[0].strip() for line in needed)
    return next((line for line in exact if line.startswith("torch==")), "torch")


def _read(path: Path) -> InstallSource:
    try:
        return InstallSource("", path.name, path.read_bytes())
    except OSError as error:
        raise SettingsError(
            f"{path}: cannot be read ({error.strerror or error}) (--install).",
            remedy="Name a wheel that exists.",
        ) from error


def _built(checkout: Path) -> InstallSource:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir"]
        tries = (
            [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder],
            [*command, folder],
        )
        said = ""
        for each in tries:
            try:
                done = subprocess.run(
                    [*each, str(checkout)],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    timeout=_BUILD_PATIENCE_S,
                    check=False,
                )
            except (OSError, subprocess.TimeoutExpired) as error:
                said = str(error)
                continue
            wheels = sorted(Path(folder).glob("*.whl"))
            if done.returncode == 0 and wheels:
                return _read(wheels[0])
            lines = done.stdout.decode(errors="replace").strip().splitlines()
            said = lines[-1] if lines else f"code {done.returncode}"
    raise SettingsError(
        f"No wheel can be made of {checkout}: {said}.",
        remedy="Install the tools with `pip install build hatchling`, or name a wheel, an address "
        "or a version with --install.",
    )
