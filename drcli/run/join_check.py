"""Whether a worker on another machine would drive exactly as the training's own.

It needs the same program, libraries and track. All else comes from the bucket.
"""

import hashlib
import time
from collections.abc import Mapping
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from threading import Thread

from drcli import __version__
from drcli.base.errors import DrError, SettingsError
from drcli.base.json_record import plain_json
from drcli.base.log import get_logger
from drcli.config.run_config import DriveConfig, FigureConfig
from drcli.config.track_names import own_route_file, races_with_lists
from drcli.model import keys
from drcli.model.run_metadata import installed_versions
from drcli.records.job import Job, JoinRecord
from drcli.run.duty import Duty
from drcli.workers.cores import with_known_overlap

LIBRARIES = ("torch", "mujoco", "numpy")

SOURCE = "source code of drcli"

_SUFFIXES = (".py", ".json", ".xml", ".npy")


def versions() -> dict[str, str]:
    """Of all that decides what a car does; without torch's build kind (`+cpu`)."""
    found = {"drcli": __version__, SOURCE: _source_hash()}
    for name, version in installed_versions(LIBRARIES).items():
        found[name] = (version or "missing").partition("+")[0]
    return found


def _source_hash() -> str:
    total = hashlib.sha256()
    for package in ("drcli", "drsim"):
        spec = find_spec(package)
        for place in sorted(spec.submodule_search_locations or ()) if spec is not None else ():
            folder = Path(place)
            files = [path for path in folder.rglob("*") if path.suffix in _SUFFIXES]
            for path in sorted(files, key=lambda each: each.relative_to(folder).as_posix()):
                total.update(path.relative_to(folder).as_posix().encode() + b"\0")
                total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()[:16]


def routes(job: Job) -> dict[str, str]:
    """SHA-256 of the racer's own route files, by DR_WORLD_NAME."""
    found = {}
    for race in races_of(job):
        path = own_route_file(race)
        if path is not None:
            found[race.world_name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def races_of(job: Job) -> list[DriveConfig]:
    races = [*job.config.races, *(race for stage in job.stages for race in stage.races)]
    return races_with_lists(races)


def refuse_other_machine(record: JoinRecord, job: Job) -> None:
    """SettingsError if versions or tracks differ from the training's."""
    refuse_other_versions(record.versions)
    here = routes(job)
    for race in races_of(job):
        world = race.world_name
        wanted = record.tracks.get(world)
        if wanted is None:
            continue
        if world not in here:
            raise SettingsError(
                f"DR_WORLD_NAME={world}: the training drives on a track of its own, which is not "
                f"in {race.tracks_folder} on this machine.",
                remedy="Copy its route file there from the machine of the training.",
            )
        if here[world] != wanted:
            raise SettingsError(
                f"DR_WORLD_NAME={world}: the route file in {race.tracks_folder} is not the one "
                "that the training uses.",
                remedy="Copy that file from the machine of the training.",
            )


def refuse_other_versions(wanted: Mapping[str, str]) -> None:
    here = versions()
    for name in sorted(wanted.keys() & here.keys(), key=lambda each: each == SOURCE):
        if wanted[name] == here[name]:
            continue
        if name == SOURCE:
            raise SettingsError(
                f"The training runs other source code of drcli {here['drcli']} than this machine.",
                remedy="Install the same commit on both machines.",
            )
        raise SettingsError(
            f"The training uses {name} {wanted[name]}, this machine {here[name]}: cars would not "
            "drive the same.",
            remedy=f"Install {name} {wanted[name]} here.",
        )


# Publishes what simulation workers elsewhere need to join; without secrets.


_logger = get_logger(__name__)


LATER_S = 3.0
"""The training's own workers start meanwhile."""


class JoinOffer(Duty):
    name = "join offer"

    def start(self) -> None:
        Thread(target=self._write, name="join-offer", daemon=True).start()

    def _write(self) -> None:
        job = self.run.job
        time.sleep(LATER_S if job.config.train.workers else 0.0)
        try:
            key = keys.join_record(job.config.model.prefix)
            self.bucket.put(key, offer(job).encode())
        except (DrError, OSError) as error:
            _logger.warning("No worker can join this training: %s", error)


def offer(job: Job) -> JoinRecord:
    public = job.without_addresses()
    figures = FigureConfig(**{each.field: each.default for each in FigureConfig.declared.values()})
    train = with_known_overlap(job.config.train)
    config = replace(public.config, train=train, figures=figures, given={})
    sent = plain_json(replace(public, config=config))
    return JoinRecord(job.session, versions(), routes(job), sent)
