"""Makes a video with all that bucket and settings tell."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from drcli.base.errors import BadValue, DrError, SettingsError
from drcli.base.installation import lazy_imports
from drcli.bucket.bucket import Bucket
from drcli.config.run_config import DriveConfig, ModelConfig
from drcli.config.value_types import parse_checkpoint
from drcli.model import keys, race_keys
from drcli.model.checkpoint_choice import ModelCheckpoints
from drcli.model.model_store import ModelStore
from drcli.view.video.film import View
from drcli.view.video.make_video import VideoOptions, VideoReport, chosen_laps, film_trace
from drcli.view.video.recorded_lap import RecordedLap, find_world, load_world
from drcli.view.video.trace_source import FoundTrace, trace_of_evaluation, trace_of_file

if TYPE_CHECKING:
    from drcli.view.saliency.policy_outputs import ExplainedPolicy

with lazy_imports():
    from drcli.view.saliency import policy_outputs

NO_POLICY = "none"
_POLICY_FILES = (".pb", ".onnx", ".xml", ".tflite", ".gz", ".tgz")


@dataclass(frozen=True)
class PolicyOptions:
    """Whose probabilities are shown.

    Attributes:
        name: Checkpoint, file, `NO_POLICY`, or None for the checkpoint that drove.
        metadata: Of a file; None if it lies beside it.
        iteration: Of a training; None for an evaluation.
    """

    name: str | None = None
    metadata: Path | None = None
    iteration: int | None = None


@dataclass(frozen=True)
class Defaults:
    model: ModelConfig
    tracks_folder: Path
    world: str
    racer: str
    color: str

    @staticmethod
    def of(model: ModelConfig, race: DriveConfig) -> "Defaults":
        names = race.world_name, race.racer_name, race.car_color
        return Defaults(model, race.tracks_folder, *names)


def make_video(
    defaults: Defaults,
    bucket: Callable[[], Bucket],
    trace: FoundTrace,
    options: VideoOptions,
    files: Sequence[tuple[View, Path]],
    *,
    world: str | None = None,
    policy: PolicyOptions | None = None,
    ghosts: Sequence[str] = (),
    on_progress: Callable[[str], object] = lambda _: None,
) -> VideoReport:
    """Film a trace with everything that is known about it.

    The bucket is opened only where needed; `ghosts` are trace files or evaluation stamps.

    Raises:
        SettingsError: Track or policy is missing, or a file cannot be written.
        NotAvailable: A library is missing.
    """
    recording = trace.recording
    folder = defaults.tracks_folder
    if world is not None:
        track = load_world(world, folder)
    elif recording is not None:
        track = load_world(recording.world, folder)
    else:
        track = find_world(trace.laps, defaults.world, folder, trace.origin)
    subject, driver, notes = _policy(defaults, bucket, trace, policy or PolicyOptions())
    if options.explain and subject is None:
        raise SettingsError(
            "No policy is known whose pixels could be explained.",
            remedy="Name a checkpoint or a file with --policy, or leave out --explain.",
        )
    others = [_ghost(bucket, trace, name) for name in ghosts]
    racer = options.racer or (recording.racer if recording is not None else defaults.racer)
    color = options.color or (recording.color if recording is not None else defaults.color)
    report = film_trace(
        trace,
        track,
        replace(options, racer=racer, color=color),
        files,
        subject=subject,
        driver=driver or _driver(trace),
        others=others,
        on_progress=on_progress,
    )
    return replace(
        report,
        checkpoint=driver.rpartition("checkpoint ")[2] if subject is not None else "",
        notes=[*report.notes, *notes],
    )


def _driver(trace: FoundTrace) -> str:
    recording = trace.recording
    if recording is None:
        # A path says nothing to viewers, and names the folders of who made the video.
        return f"{trace.model} · {trace.origin}" if trace.model else trace.stem
    number = recording.checkpoint.partition("_")[0]
    model = race_keys.submitted_model(recording.model)
    return f"{model} · checkpoint {number}" if number else model


def _policy(
    defaults: Defaults,
    bucket: Callable[[], Bucket],
    trace: FoundTrace,
    options: PolicyOptions,
) -> tuple["ExplainedPolicy | None", str, list[str]]:
    if options.name == NO_POLICY:
        return None, "", []
    if options.name is not None and Path(options.name).suffix.lower() in _POLICY_FILES:
        path = Path(options.name).expanduser()
        return policy_outputs.open_policy_file(path, options.metadata), path.name, []
    if options.name is not None:
        if not trace.model:
            raise SettingsError(
                f"{trace.origin} names no model, so --policy {options.name:.40} cannot be found.",
                remedy="Name a file with --policy, such as model_0.pb.",
            )
        return _checkpoint(defaults, bucket(), trace.model, options.name)
    recording = trace.recording
    recorded = "" if recording is None else recording.checkpoint
    name = recorded or ("" if options.iteration is None else str(options.iteration))
    if not trace.model or not name:
        return None, "", []
    try:
        return _checkpoint(defaults, bucket(), trace.model, name)
    except DrError:
        number = name.partition("_")[0]
        note = (
            f"Checkpoint {number} of {trace.model}, which drove, is no longer there: the video "
            "shows no probabilities. --policy names another one."
        )
        return None, "", [note]


def _checkpoint(
    defaults: Defaults, bucket: Bucket, model: str, name: str
) -> tuple["ExplainedPolicy | None", str, list[str]]:
    try:
        choice = parse_checkpoint(name)
    except BadValue as error:
        raise SettingsError(f"--policy {name:.60} {error.reason}.", remedy=error.remedy) from None
    checkpoints = ModelCheckpoints.read(ModelStore.of(defaults.model, bucket, model))
    found = checkpoints.choose(choice).name
    number = found.partition("_")[0]
    title = f"{race_keys.submitted_model(model)} · checkpoint {number}"
    return policy_outputs.open_policy(ModelStore(bucket, model), found), title, []


def _ghost(bucket: Callable[[], Bucket], trace: FoundTrace, name: str) -> tuple[str, RecordedLap]:
    path = Path(name).expanduser()
    if path.exists():
        other, title = trace_of_file(path), path.parent.parent.name or path.stem
    elif trace.model and (name == "last" or name.isdecimal()):
        stamp = None if name == "last" else name
        other, title = trace_of_evaluation(ModelStore(bucket(), trace.model), stamp), name
    else:
        raise SettingsError(
            f"--ghost {name:.60} is neither a file nor an evaluation of a model.",
            remedy="Name a simtrace file, or the fourteen digits of an evaluation.",
        )
    return title, chosen_laps(other.laps, "best", other.origin)[0]


def put_videos(model: ModelStore, stamp: str, files: dict[View, Path]) -> list[str]:
    """Put an evaluation's videos where DeepRacer-for-Cloud has them; returns keys.

    The complete view, last, is also put beside the trace: the next evaluation replaces the others.
    """
    put = []
    for view, path in sorted(files.items(), key=lambda file: file[0] == "film"):
        key = keys.video(model.prefix, CAMERAS[view])
        model.bucket.put(key, path.read_bytes())
        put.append(key)
    if "film" in files and stamp:
        key = keys.evaluation_video(model.prefix, stamp)
        model.bucket.put(key, files["film"].read_bytes())
        put.append(key)
    return put


CAMERAS: dict[View, str] = {
    "film": "camera-pip",
    "chase": "camera-45degree",
    "top": "camera-topview",
}
"""Source: the reference simulator."""
