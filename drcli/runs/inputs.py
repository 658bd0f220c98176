"""The racer's three files: found, checked, and frozen below the model prefix."""

import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from drcli.config import Settings
from drcli.findings import Finding
from drcli.job import Job
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing
from drcli.validate.report import Violation

TRIAL_TIMEOUT_S = 60.0
"""How long the trial of world and reward function may take, endless loops included."""

TRIAL_RESULT = "trial.json"
"""File in which the trial leaves what it found."""


@dataclass(frozen=True)
class InputFile:
    """One of the racer's files.

    Attributes:
        name: File name.
        data: Its content.
        origin: Where it was found, for people.
    """

    name: str
    data: bytes
    origin: str


@dataclass(frozen=True)
class Inputs:
    """Everything a training is made of besides its settings."""

    reward: InputFile
    hyperparameters: InputFile
    metadata: InputFile


def find(settings: Settings, directory: Path, bucket: Bucket | None) -> dict[str, InputFile]:
    """Find the three files: in `custom_files/`, else in the bucket, else the shipped examples.

    The shipped examples only serve a racer who has brought no file at all: one file missing
    among others is a mistake.

    Args:
        settings: Say where they are.
        directory: The racer's working folder.
        bucket: None where it cannot be read.

    Returns:
        What was found, by file name.
    """
    local = custom_files_folder(settings, directory)
    found: dict[str, InputFile] = {}
    for name, key in places(settings).items():
        path = local / name
        if path.is_file():
            found[name] = InputFile(name, path.read_bytes(), str(path))
        elif bucket is not None:
            try:
                found[name] = InputFile(name, bucket.get(key), f"{bucket.name}/{key}")
            except ObjectMissing:
                continue
    if found or bucket is None:
        return found
    shipped = {name: shipped_file(name) for name in places(settings)}
    return {name: InputFile(name, path.read_bytes(), str(path)) for name, path in shipped.items()}


def places(settings: Settings) -> dict[str, str]:
    """Where the three files lie in the bucket, by file name."""
    return {
        keys.REWARD_FUNCTION_FILE: settings.reward_key,
        keys.HYPERPARAMETERS_FILE: settings.hyperparameters_key,
        keys.MODEL_METADATA_FILE: settings.model_metadata_key,
    }


def missing_files(
    found: Mapping[str, InputFile], settings: Settings, directory: Path, bucket: str
) -> dict[str, Finding]:
    """A finding for each of the three files that is not there, by file name."""
    local = custom_files_folder(settings, directory)
    return {
        name: Finding(
            str(local),
            f"there is no {name} here nor in the bucket at {bucket}/{key}",
            f"Put your {name} into {local}; an example is {shipped_file(name)}.",
        )
        for name, key in places(settings).items()
        if name not in found
    }


def upload_custom_files(
    settings: Settings, directory: Path, bucket: Bucket, inputs: Inputs
) -> None:
    """Copy the racer's local files to where the bucket keeps them for the next start."""
    local = custom_files_folder(settings, directory)
    places = (
        (inputs.reward, settings.reward_key),
        (inputs.hyperparameters, settings.hyperparameters_key),
        (inputs.metadata, settings.model_metadata_key),
    )
    for file, key in places:
        if Path(file.origin).parent == local:
            bucket.put(key, file.data)


def try_inputs(job: Job, reward: InputFile | None) -> list[Violation]:
    """Load the worlds and try the reward function on them, in a process that can be given up.

    The launcher itself never imports a racer's code.

    Args:
        job: Its settings and folder count.
        reward: The reward function; None loads the worlds only.
    """
    job.folder.mkdir(parents=True, exist_ok=True)
    result = job.folder / TRIAL_RESULT
    result.unlink(missing_ok=True)
    arguments: list[str] = []
    if reward is not None:
        path = job.folder / keys.REWARD_FUNCTION_FILE
        path.write_bytes(reward.data)
        arguments = [str(path), reward.origin]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "drcli.worker.trial", *arguments],
            env=job.to_environment(),
            cwd=job.directory,
            stdin=subprocess.DEVNULL,
            # What a reward function prints may be without end.
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            timeout=TRIAL_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        what = f"Trying the reward function took longer than {TRIAL_TIMEOUT_S:.0f} seconds."
        return [_lost(reward, what, "Look for an endless loop in it.")]
    if result.exists():
        return [Violation(**fields) for fields in json.loads(result.read_text("utf-8"))]
    if reward is None or "Traceback" in done.stderr:
        raise RuntimeError(f"The trial of the reward function failed:\n{done.stderr}")
    what = f"The reward function ended the process that tried it (exit code {done.returncode})."
    return [_lost(reward, what, "Remove what ends the process, such as os._exit or os.kill.")]


def _lost(reward: InputFile | None, message: str, remedy: str) -> Violation:
    return Violation("V-21", "error", reward.origin if reward is not None else "", message, remedy)


def custom_files_folder(settings: Settings, directory: Path) -> Path:
    """Where the racer's own files lie: an experiment has its own."""
    if settings.experiment_name:
        return directory / "experiments" / settings.experiment_name / "custom_files"
    return directory / "custom_files"


def shipped_file(name: str) -> Path:
    """An example of ours: inside the installed package, or in a checkout's `defaults` folder."""
    package = Path(str(resources.files("drcli")))
    for folder in (package / "_defaults", package.parent / "defaults"):
        if (folder / name).is_file():
            return folder / name
    raise FileNotFoundError(name)
