"""What tasks about models do in their own process."""

import io
import math
import tarfile
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from drcli.base.errors import SettingsError
from drcli.base.files import safe_name
from drcli.base.installation import lazy_imports
from drcli.bucket.bucket import Bucket, ObjectInfo, ObjectMissing, Watch
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.loading import load_settings
from drcli.config.value_types import CheckpointChoice
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.model.traces import traces_of
from drcli.records.run_record import KINDS, log_folder
from drcli.run.evaluation import launch_evaluation
from drcli.run.evaluation_plan import prepare_evaluation
from drcli.run.track_fetch import fetch_allowed
from drcli.transfer.export_model import Selection, read_export_source
from drcli.transfer.find_checkpoint import OwnModel
from drcli.transfer.model_removal import plan_removal, remove_models
from drcli.transfer.report_place import report_file
from drcli.transfer.transfer_buckets import bucket_to_look_at
from drcli.view.video.encode import require_encoder
from drcli.web import start_routes
from drcli.web.model_reader import settings_for
from drcli.web.tasks import Progress

if TYPE_CHECKING:
    from drcli.analysis.run import Run

with lazy_imports():
    from drcli.analysis import analysis as analyses
    from drcli.analysis import outputs, read_run
    from drcli.analysis.report import map_section
    from drcli.checks import compare_on_drive
    from drcli.run import plan as run_plan
    from drcli.transfer import download, export_car, export_forms, import_model, upload
    from drcli.view.video import make_video, trace_source, video_job

# Packs a model, or its logs, into one archive.


_STEPS = ("-simtrace/", "/mp4/", "/video.mp4")
"""Traces and videos are large, and no import reads them."""


@dataclass(frozen=True)
class PackedModel:
    model: str
    file: str
    files: int
    size_bytes: int


def pack_model(
    model: ModelStore,
    path: Path,
    *,
    traces: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> PackedModel:
    """Write a model as `.tar.gz`, which `dr-import` and consoles read.

    Raises:
        SettingsError: There is none, or the file cannot be written.
        StorageError: The bucket does not answer.
    """
    folder = keys.folder(model.prefix)
    own = [info for info in traces_of(model).objects if info.key.startswith(folder)]
    if not traces:
        own = [info for info in own if not any(part in f"/{info.key}" for part in _STEPS)]
    if not own:
        raise _nothing(model, "files")
    own.sort(key=lambda info: info.key)
    with _archive(path) as archive:
        count = _add_objects(archive, model.bucket, own, folder, progress)
    return PackedModel(model.prefix, str(path), count, path.stat().st_size)


def pack_logs(
    model: ModelStore,
    directory: Path,
    path: Path,
    progress: Callable[[str], None] = lambda text: None,
) -> PackedModel:
    """Pack the logs of this machine, else those in the bucket.

    Raises:
        SettingsError: There are none, or the file cannot be written.
        StorageError: The bucket does not answer.
    """
    if not keys.is_valid_prefix(model.prefix):
        raise _nothing(model, "logs")
    here = {
        f"{kind}/{file.name}": file
        for kind in KINDS
        for file in sorted(_files(log_folder(directory, model.prefix, kind)))
    }
    folder = f"{keys.folder(model.prefix)}logs/"
    stored = [
        info for info in model.bucket.list(folder) if info.key.removeprefix(folder) not in here
    ]
    if not here and not stored:
        raise _nothing(model, "logs")
    with _archive(path) as archive:
        for name, file in here.items():
            archive.add(file, f"logs/{name}", recursive=False)
        count = _add_objects(archive, model.bucket, stored, keys.folder(model.prefix), progress)
    return PackedModel(model.prefix, str(path), len(here) + count, path.stat().st_size)


def _files(folder: Path) -> Iterator[Path]:
    if folder.is_dir():
        for path in folder.iterdir():
            if path.is_file() and not path.is_symlink():
                yield path


@contextmanager
def _archive(path: Path) -> Iterator[tarfile.TarFile]:
    try:
        with tarfile.open(path, "w:gz", compresslevel=1, dereference=False) as archive:
            yield archive
    except OSError as error:
        path.unlink(missing_ok=True)
        raise SettingsError(
            f"{path} cannot be written: {error.strerror or error}.",
            remedy="Make room on the disk, then try again.",
        ) from error
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def _add_objects(
    archive: tarfile.TarFile,
    bucket: Bucket,
    objects: Iterable[ObjectInfo],
    folder: str,
    progress: Callable[[str], None],
) -> int:
    every = list(objects)
    count = 0
    for number, info in enumerate(every):
        if number % 20 == 0:
            progress(f"{number} of {len(every)} files")
        try:
            data = bucket.get(info.key)
        except ObjectMissing:
            continue  # a training deletes its older checkpoints
        member = tarfile.TarInfo(info.key.removeprefix(folder))
        member.size, member.mtime = len(data), int(info.modified.timestamp())
        archive.addfile(member, io.BytesIO(data))
        count += 1
    return count


def _nothing(model: ModelStore, what: str) -> SettingsError:
    return SettingsError(
        f"{model.url} has no {what}.",
        remedy="`dr-list-models` lists all models.",
    )


DownloadKind = Literal["car", "onnx", "logs", "model", "everything"]
"""`onnx`: a policy; `model`: without traces and videos."""


def make_download(
    progress: Progress,
    directory: Path,
    prefix: str,
    kind: DownloadKind,
    choice: CheckpointChoice,
    folder: Path,
) -> dict[str, Any]:
    """Returns the path and the report of the command."""
    settings = settings_for(directory, prefix)
    name = safe_name(prefix)
    if kind == "car":
        source = read_export_source(settings, Selection(choice, prefix))
        path = export_car.archive_path(folder, source.file_name)
        progress("Writes the graph and compares it with the weights on a drive.")
        report = export_car.write_archive(
            compare_on_drive.made_car_archive(settings, source, path.name), path
        )
        return {"file": str(path), "report": report}
    if kind == "onnx":
        return _onnx(progress, settings, prefix, choice, folder)

    bucket = bucket_to_look_at(settings.transfer, upload=False)
    model = ModelStore(bucket, prefix)
    if kind == "logs":
        path = folder / f"{name}-logs.tar.gz"
        packed = pack_logs(model, directory, path, progress)
    else:
        path = folder / f"{name}.tar.gz"
        packed = pack_model(model, path, traces=kind == "everything", progress=progress)
    return {"file": str(path), "report": packed}


def _onnx(
    progress: Progress, settings: Any, prefix: str, choice: CheckpointChoice, folder: Path
) -> dict[str, Any]:
    """With its metadata, which other programs need."""
    planned = export_forms.plan_form(settings, Selection(choice, prefix), "onnx", folder)
    progress("Writes the policy and compares it with PyTorch.")
    report = export_forms.export_form(planned)
    path = folder / f"{Path(report.file).stem}-onnx.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in map(Path, report.files):
            archive.write(file, file.name)
    return {"file": str(path), "report": report}


def analyse_model(progress: Progress, directory: Path, prefix: str) -> dict[str, Any]:
    """Verdict and advice of dr-start-loganalysis."""
    settings = settings_for(directory, prefix)
    progress("Reads traces, metrics and evaluations.")
    analysis = analyses.analyse(read_run.read_run(settings, prefix))
    progress("Writes the report.")
    report = outputs.write_report(report_file(directory, prefix), analysis)
    return {
        "verdict": report.verdict,
        "advice": report.advice,
        "world": report.world,
        "episodes": report.episodes,
        "complete_laps": report.complete_laps,
        "best_lap_s": report.best_lap_s,
        "limit": report.limit,
        "problems": report.problems,
        "ends": ends_of(analysis.run),
    }


MOST_ENDS = 4_000
"""Of more, every second one is left out, or two of three ..."""


def ends_of(run: "Run") -> list[list[float]]:
    """Iteration, x and y, metres, where each training episode ended before its lap was complete."""
    steps = map_section.located(run.steps)
    if steps.empty:
        return []
    last = steps.drop_duplicates("unique_episode", keep="last").set_index("unique_episode")
    lost = run.episodes[~run.episodes["complete"].astype(bool)]
    lost = lost[lost.index.isin(last.index)]
    lost = lost[:: math.ceil(max(1, len(lost)) / MOST_ENDS)]
    places = last.loc[lost.index, ["x", "y"]].round(2).to_numpy().tolist()
    return [
        [int(iteration), *place] for iteration, place in zip(lost["iteration"], places, strict=True)
    ]


def start_training(
    progress: Progress, directory: Path, prefix: str, max_minutes: float | None
) -> dict[str, Any]:
    settings = settings_for(directory, prefix)
    fetch_allowed(settings)
    options = run_plan.StartOptions(resume=True, max_minutes=max_minutes)
    return start_routes.start_training(progress, settings, options, fetches=False)


def start_evaluation(
    progress: Progress, directory: Path, prefix: str, flags: dict[str, str]
) -> dict[str, Any]:
    settings = settings_for(directory, prefix, flags)
    fetch_allowed(settings)
    plan = prepare_evaluation(settings, on_progress=progress)
    record = launch_evaluation(plan)
    return {
        "stamp": plan.stamp,
        "metrics": plan.metrics,
        "checkpoint": record.checkpoint,
        "world": record.world,
        "pid": record.pid,
        "pid_started": record.pid_started,
    }


def make_lap_video(
    progress: Progress,
    directory: Path,
    prefix: str,
    stamp: str,
    video_options: dict[str, Any],
    path: Path | None,
) -> dict[str, Any]:
    """Film an evaluation as dr-video does, and put the film beside its trace.

    `video_options` has fields of `make_video.VideoOptions`; `path`: a film to download instead.
    """
    require_encoder()
    settings = settings_for(directory, prefix)
    bucket = bucket_to_look_at(settings.transfer, upload=False)
    trace = trace_source.trace_of_evaluation(ModelStore(bucket, prefix), stamp)
    defaults = video_job.Defaults.of(settings.model, settings.race)

    def film(target: Path) -> Any:
        wanted = make_video.VideoOptions(
            **{
                "racer": "",
                "color": "",
                "most_seconds": make_video.USUAL_SECONDS,
                "stuck_seconds": make_video.STUCK_SECONDS,
                **video_options,
            }
        )
        progress(make_video.plan_of(trace, wanted, [target]))
        return video_job.make_video(
            defaults, lambda: bucket, trace, wanted, [("film", target)], on_progress=progress
        )

    if path is not None:
        return {"file": str(path), "report": film(path)}
    with tempfile.TemporaryDirectory(prefix="drcli-video-") as temporary:
        target = Path(temporary) / "film.mp4"
        report = film(target)
        own = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
        own.put(keys.evaluation_video(prefix, stamp), target.read_bytes())
    return {"stamp": stamp, "report": report}


def upload_model(
    progress: Progress,
    directory: Path,
    prefix: str,
    choice: CheckpointChoice,
    to: str,
    local: bool,
) -> Any:
    settings = settings_for(directory, prefix)
    options = upload.UploadOptions(choice, prefix=prefix, to=to or None, local=local)
    planned = upload.plan_upload(settings, options)
    return upload.upload(planned, settings, _bars(progress))


def import_archive(
    progress: Progress, directory: Path, source: Path, prefix: str, world: str | None
) -> Any:
    settings = load_settings(directory)
    progress("Reads and compares the model.")
    options = import_model.ImportOptions(str(source), prefix, world=world)
    try:
        planned = import_model.plan_import(settings, options)
    except OwnModel:
        copy = download.plan_download(settings, import_model.copy_of_own(settings, options))
        return download.download(copy, settings, _bars(progress))
    return import_model.import_model(planned, settings, _bars(progress))


def delete_model(progress: Progress, directory: Path, prefix: str, forget: bool) -> Any:
    settings = load_settings(directory)
    planned = plan_removal(settings, [prefix], forget=forget)
    progress("Deletes its objects and its files on this machine.")
    return remove_models(planned, settings)


def _bars(progress: Progress) -> Any:
    @contextmanager
    def bar(title: str, total: int) -> Iterator[Watch]:
        done, shown = 0, -1

        def watch(more: int) -> None:
            nonlocal done, shown
            done += more
            percent = 100 * done // max(total, 1)
            if percent != shown:
                shown = percent
                progress(f"{title}: {percent} % of {total / 1e6:.1f} MB")

        yield watch

    return bar
