"""Files and environment that a machine needs."""

import re
import shutil
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.config.settings import Settings
from drcli.config.track_names import ROUTE_FILES

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
    worlds = {race.world_name for race in settings.races}
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
