"""The racer's three files: found, checked, and frozen below the model prefix."""

import subprocess
import sys
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from drcli.config import Settings
from drcli.errors import SettingsError
from drcli.hyperparameters import Hyperparameters
from drcli.job import Job, LastWords
from drcli.model_metadata import ModelMetadata
from drcli.runs.design import Design
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing

TRIAL_TIMEOUT_S = 60.0
"""How long the trial of world and reward function may take, endless loops included."""


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

    def check(self) -> Design:
        """Read the two parameter files; the reward function needs a track to be tried on.

        Raises:
            SettingsError: With file, key, value and remedy.
        """
        parameters = Hyperparameters.from_bytes(
            self.hyperparameters.data, self.hyperparameters.origin
        )
        metadata = ModelMetadata.from_bytes(self.metadata.data, self.metadata.origin)
        conflict = parameters.conflict(
            metadata.training_algorithm, continuous=metadata.action_space.continuous
        )
        if conflict is not None:
            origin = self.hyperparameters.origin
            raise SettingsError(
                f"{origin}: {conflict}", remedy=f"Change {self.hyperparameters.name}."
            )
        return Design(metadata, parameters, self.metadata.origin, self.hyperparameters.origin)


def gather(settings: Settings, directory: Path, bucket: Bucket) -> Inputs:
    """Find the three files: in `custom_files/`, else in the bucket, else the shipped examples.

    The shipped examples only serve a racer who has brought no file at all: one file missing
    among others is a mistake.

    Raises:
        SettingsError: A file is missing.
    """
    wanted = {
        keys.REWARD_FUNCTION_FILE: settings.reward_key,
        keys.HYPERPARAMETERS_FILE: settings.hyperparameters_key,
        keys.MODEL_METADATA_FILE: settings.model_metadata_key,
    }
    local = custom_files_folder(settings, directory)
    found: dict[str, InputFile] = {}
    for name, key in wanted.items():
        path = local / name
        if path.is_file():
            found[name] = InputFile(name, path.read_bytes(), str(path))
            continue
        try:
            found[name] = InputFile(name, bucket.get(key), f"{bucket.name}/{key}")
        except ObjectMissing:
            continue
    missing = [name for name in wanted if name not in found]
    if missing and found:
        raise SettingsError(
            f"There is no {missing[0]} in {local} nor in the bucket at "
            f"{bucket.name}/{wanted[missing[0]]}.",
            remedy=f"Put your {missing[0]} into {local}; an example is {shipped_file(missing[0])}.",
        )
    for name in missing:
        path = shipped_file(name)
        found[name] = InputFile(name, path.read_bytes(), str(path))
    return Inputs(*(found[name] for name in wanted))


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


def try_inputs(job: Job, inputs: Inputs) -> None:
    """Load the world and try the reward function on it, in a process that can be given up.

    The launcher itself never imports a racer's code.

    Raises:
        SettingsError: The world or the reward function does not work; the sentence says how.
    """
    job.folder.mkdir(parents=True, exist_ok=True)
    path = job.folder / keys.REWARD_FUNCTION_FILE
    path.write_bytes(inputs.reward.data)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "drcli.worker.trial", str(path), inputs.reward.origin],
            env=job.to_environment(),
            cwd=job.directory,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=TRIAL_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise SettingsError(
            f"{inputs.reward.origin}: trying the reward function took longer than "
            f"{TRIAL_TIMEOUT_S:.0f} seconds.",
            remedy="Look for an endless loop in it.",
        ) from None
    if done.returncode == 0:
        return
    words = LastWords.find(job.folder, "trial")
    if words is not None and words.code == SettingsError.code:
        raise SettingsError(words.message, remedy=words.remedy)
    raise RuntimeError(f"The trial of the reward function failed:\n{done.stdout}{done.stderr}")


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
