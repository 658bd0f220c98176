"""Finds traces in the bucket or on disk, and what is known about them."""

import re
from dataclasses import dataclass, field, replace
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.files import is_left_behind
from drcli.base.json_record import RecordError
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.evaluation_task import RaceRecording
from drcli.view.video.recorded_lap import RecordedLap, read_laps

_EVALUATION = re.compile(r"evaluation-(\d{14})/evaluation-simtrace/0-iteration\.csv")

OPPONENT = "opponent"
"""A model's last race as an opponent, instead of an evaluation's stamp."""

MOST_BYTES = 512 * 2**20


@dataclass(frozen=True, eq=False)
class FoundTrace:
    """A trace, read.

    Attributes:
        model: Prefix of the driver, or empty.
        recording: None for other programs and versions.
        stem: For file names, and titles without a model.
    """

    origin: str
    laps: list[RecordedLap]
    model: str
    recording: RaceRecording | None
    notes: list[str] = field(default_factory=list)
    stem: str = "video"

    def objects_added(self) -> "FoundTrace":
        recording = self.recording
        if recording is None or not recording.shapes:
            return self
        return replace(self, laps=[lap.with_objects(recording) for lap in self.laps])


def trace_of_file(path: Path) -> FoundTrace:
    """A simtrace on disk, with what lies beside it; raises SettingsError."""
    path = _file(path)
    data = _bytes(path)
    laps, notes = read_laps(data, str(path))
    beside = path.parent.parent / "recording.json"
    recording = None
    if beside.is_file():
        recording = decode_recording(_bytes(beside), str(beside), notes)
    unnamed = ("/", "..", "~", "evaluation-simtrace")
    parts = [part for part in path.parts[-3:-1] if part not in unnamed]
    stem = "-".join([*parts, path.stem]).replace("-iteration", "")
    return FoundTrace(str(path), laps, "", recording, notes, stem).objects_added()


def trace_of_evaluation(model: ModelStore, stamp: str | None) -> FoundTrace:
    """The trace of a stamp or `OPPONENT`; None for the newest, without any for `OPPONENT`.

    Raises:
        SettingsError: There is none.
    """
    stamps = stored_evaluations(model)
    if stamp == OPPONENT or (stamp is None and not stamps):
        key = keys.opponent_trace(model.prefix)
        if model.bucket.exists(key):
            return trace_of_key(model, key, "the last race as the opponent", OPPONENT)
    if stamp == OPPONENT and stamps:
        raise SettingsError(
            f"{model.url} has not raced as an opponent.",
            remedy="Leave out --evaluation to film its newest evaluation.",
        )
    if not stamps:
        if next(iter(model.bucket.list(keys.folder(model.prefix))), None) is None:
            raise SettingsError(
                f"There is no model {model.prefix} in s3://{model.bucket.name}.",
                remedy="`dr-list-models` lists all models. A simtrace on disk is named by its "
                "path, as in ./lap.csv.",
            )
        raise SettingsError(
            f"{model.url} has no stored evaluation.",
            remedy="Drive one with `dr-evaluate`, or film a checkpoint with "
            "`dr-video --checkpoint best`.",
        )
    wanted = stamp or stamps[-1]
    if wanted not in stamps:
        raise SettingsError(
            f"{model.url} has no evaluation {wanted:.40}.",
            remedy=f"The newest are {', '.join(stamps[-3:])}; --evaluation last is the newest.",
        )
    return trace_of_key(
        model, keys.evaluation_trace(model.prefix, wanted), f"evaluation {wanted}", wanted
    )


def trace_of_iteration(model: ModelStore, iteration: int, worker: int) -> FoundTrace:
    """What one worker drove in an iteration.

    Raises:
        SettingsError: The bucket does not hold it.
    """
    for key in keys.training_traces(model.prefix, iteration, worker):
        if model.bucket.exists(key):
            name = f"training iteration {iteration}"
            return trace_of_key(model, key, name, f"iteration-{iteration}")
    raise SettingsError(
        f"{model.url} has no trace of iteration {iteration}"
        + (f" of worker {worker}." if worker else "."),
        remedy="`dr-analyze` shows the iterations; older traces may have been deleted "
        "(DR_TRAIN_TRACES_MAX_MB).",
    )


def trace_of_key(model: ModelStore, key: str, name: str, stem: str) -> FoundTrace:
    """Raises SettingsError for other files, StorageError for a bucket that fails."""
    laps, notes = read_laps(model.bucket.get(key), f"s3://{model.bucket.name}/{key}")
    recording = None
    beside = keys.recording_of(key)
    if "evaluation-simtrace/" in key and model.bucket.exists(beside):
        recording = decode_recording(
            model.bucket.get(beside), f"s3://{model.bucket.name}/{beside}", notes
        )
    stem = f"{model.prefix.replace('/', '-')}-{stem}"
    return FoundTrace(name, laps, model.prefix, recording, notes, stem).objects_added()


def stored_evaluations(model: ModelStore) -> list[str]:
    """Stamps with a trace, oldest first."""
    folder = keys.folder(model.prefix)
    names = (info.key.removeprefix(folder) for info in model.bucket.list(folder))
    return sorted(found[1] for name in names if (found := _EVALUATION.fullmatch(name)))


def decode_recording(data: bytes, origin: str, notes: list[str]) -> RaceRecording | None:
    """None, with a note, if it is damaged."""
    try:
        return RaceRecording.decode(data)
    except RecordError as error:
        notes.append(f"{origin} is damaged ({error}), so objects and names are not shown.")
        return None


def _file(path: Path) -> Path:
    if not path.exists():
        raise SettingsError(f"{path} does not exist.", remedy="Correct the path.")
    if not path.is_dir():
        return path
    found = sorted(each for each in path.rglob("*-iteration.csv") if not is_left_behind(each.name))
    if len(found) != 1:
        raise SettingsError(
            f"{path} holds {len(found) or 'no'} simtrace" + ("s." if len(found) > 1 else "."),
            remedy="Name one file, such as "
            + (f"{found[-1]}." if found else "evaluation-simtrace/0-iteration.csv."),
        )
    return found[0]


def _bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > MOST_BYTES:
            raise SettingsError(
                f"{path} has {path.stat().st_size >> 20} MB, more than any simtrace.",
                remedy="Name a file such as evaluation-simtrace/0-iteration.csv.",
            )
        return path.read_bytes()
    except OSError as error:
        raise SettingsError(
            f"{path} cannot be read: {error.strerror or error}.", remedy="Correct its permissions."
        ) from None
