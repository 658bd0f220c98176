"""Files and environment that a machine needs."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import drcli
from drcli.base.errors import SettingsError
from drcli.base.files import find_files
from drcli.config import activation, secret_environment
from drcli.config.run_config import DriveConfig
from drcli.config.settings import Settings
from drcli.config.track_names import ROUTE_FILES, own_route_file, races_with_lists
from drcli.model.files.custom_files import FILE_RULES

MOST_TRACK_BYTES = 20_000_000

_WORKER_FILE = re.compile(r"worker-\d+\.env")
_REFERENCE = re.compile(r"\$\{?([A-Za-z_]\w*)")
_OF_THE_MACHINE = {"HOME", "PATH"}


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
            beside = path.suffix in (".env", ".yaml", ".yml", *ROUTE_FILES)
            if path.is_file():
                shutil.copyfile(path, (folder if beside else folder / "custom_files") / path.name)
        if (source / "tracks").is_dir():
            shutil.copytree(source / "tracks", folder / "tracks")
    except OSError as error:
        raise SettingsError(
            f"{error.filename or source}: cannot be copied ({error.strerror or error}).",
            remedy="Check the permissions of the file.",
        ) from error


def environment(
    settings: Settings, bucket: str, region: str, stack: str, variables: Mapping[str, str]
) -> dict[str, str]:
    """Variables of a training there; they override its files.

    `variables` are those of this shell. Of these, the machine gets settings and what settings
    refer to with `$NAME`, but no passwords: everybody who can read the bucket could read them.
    """
    plain, _ = secret_environment.split(activation.chosen(variables))
    texts = b"".join(_read(path) for path in _settings_files(settings).values()).decode(
        "utf-8", "replace"
    )
    referred = {
        name
        for name in _REFERENCE.findall(texts)
        if name not in _OF_THE_MACHINE and not name.startswith("AWS_")
    }
    set_here = {name for name, place in settings.sources.items() if place.file == "environment"}
    found = {
        **{name: plain[name] for name in sorted(referred | set_here) if name in plain},
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
        # As in deepracer-on-the-spot, whatever the settings say.
        "DR_UPLOAD_MODEL_ON_COMPLETION": "True",
        # It needs a password, which a machine does not get.
        "DR_IMPORT_MODEL_ON_COMPLETION": "False",
    }
    if settings.upload_s3_bucket in ("not-defined", "", bucket):
        found["DR_UPLOAD_S3_BUCKET"] = bucket
    if settings.tracks_dir is not None:
        found["DR_TRACKS_DIR"] = "tracks"
    if settings.tracks_fetch != "never":
        found["DR_TRACKS_FETCH"] = "always"
    return found


def files_to_send(
    settings: Settings, races: Sequence[DriveConfig] = (), further: Iterable[Path] = ()
) -> dict[str, bytes]:
    """Settings, the racer's three files, and route files, by path in the machine's folder.

    `races` and `further` are those of the stages of its curriculum: their tracks, and its files.

    Raises:
        SettingsError: A file is unreadable or outside of the folder, or the tracks are too large.
    """
    folder, own = settings.directory, settings.custom_files.folder
    paths = _settings_files(settings)
    for path in (*(own / name for name in FILE_RULES), *further):
        if path.is_file():
            paths[_below(path, folder)] = path
    tracks = settings.tracks_folder
    driven = races_with_lists([*settings.races, *races])
    worlds = {race.world_name for race in driven}
    routes = [
        path
        for path in (sorted(tracks.iterdir()) if tracks.is_dir() else ())
        if path.suffix in ROUTE_FILES and {path.stem, path.name} & worlds
    ]
    routes += [path for path in map(own_route_file, driven) if path is not None]
    for path in routes:
        inside = path.parent != tracks and path.is_relative_to(folder)
        paths[_below(path, folder) if inside else f"tracks/{path.name}"] = path
    found = {name: _read(path) for name, path in paths.items()}
    size = sum(len(found[name]) for name, path in paths.items() if path in routes)
    if size > MOST_TRACK_BYTES:
        raise SettingsError(
            f"{tracks}: the tracks of this training take {size / 1e6:.0f} MB.",
            remedy=f"Use route files with less than {MOST_TRACK_BYTES / 1e6:.0f} MB together.",
        )
    return found


def _settings_files(settings: Settings) -> dict[str, Path]:
    folder = settings.directory
    places = [folder]
    if settings.experiment_name:
        places.append(folder / "experiments" / settings.experiment_name)
    return {
        path.relative_to(folder).as_posix(): path
        for place in places
        for path in sorted(find_files(place, "*.env"))
        if path.name in ("run.env", "system.env") or _WORKER_FILE.fullmatch(path.name)
    }


def _below(path: Path, folder: Path) -> str:
    path = Path(os.path.normpath(path))
    if not path.is_relative_to(folder):
        raise SettingsError(
            f"{path} is outside of {folder}, so the machine would not have it.",
            remedy="Move the file into the folder of run.env.",
        )
    return path.relative_to(folder).as_posix()


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise SettingsError(
            f"{path}: cannot be read ({error.strerror or error}).",
            remedy="Check the permissions of the file.",
        ) from error


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
        return _read_wheel(Path(wanted))
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


def _read_wheel(path: Path) -> InstallSource:
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
                return _read_wheel(wheels[0])
            lines = done.stdout.decode(errors="replace").strip().splitlines()
            said = lines[-1] if lines else f"code {done.returncode}"
    raise SettingsError(
        f"No wheel can be made of {checkout}: {said}.",
        remedy="Install the tools with `pip install build hatchling`, or name a wheel, an address "
        "or a version with --install.",
    )
