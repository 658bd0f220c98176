"""What tasks about models do in their own process."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from drcli.base.replaceable import safe_name
from drcli.config.checkpoint_words import CheckpointChoice
from drcli.store.bucket import Watch
from drcli.web import start_work
from drcli.web.model_reader import settings_for
from drcli.web.tasks import Progress

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
        from drcli.models.export_car import archive_path, write_archive
        from drcli.models.export_model import Selection, read_export_source
        from drcli.runs.car_archive_on_drive import made_car_archive

        source = read_export_source(settings, Selection(choice, prefix))
        path = archive_path(folder, source.file_name)
        progress("Writes the graph and compares it with the weights on a drive.")
        report = write_archive(made_car_archive(settings, source, path.name), path)
        return {"file": str(path), "report": report}
    if kind == "onnx":
        return _onnx(progress, settings, prefix, choice, folder)
    from drcli.models.pack_model import pack_logs, pack_model
    from drcli.models.transfer_buckets import bucket_to_look_at

    bucket = bucket_to_look_at(settings.transfer, upload=False)
    if kind == "logs":
        path = folder / f"{name}-logs.tar.gz"
        packed = pack_logs(bucket, directory, prefix, path, progress)
    else:
        path = folder / f"{name}.tar.gz"
        packed = pack_model(bucket, prefix, path, traces=kind == "everything", progress=progress)
    return {"file": str(path), "report": packed}


def _onnx(
    progress: Progress, settings: Any, prefix: str, choice: CheckpointChoice, folder: Path
) -> dict[str, Any]:
    """With its metadata, which other programs need."""
    import zipfile

    from drcli.models.export_forms import export_form, plan_form
    from drcli.models.export_model import Selection

    planned = plan_form(settings, Selection(choice, prefix), "onnx", folder)
    progress("Writes the policy and compares it with PyTorch.")
    report = export_form(planned)
    path = folder / f"{Path(report.file).stem}-onnx.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in map(Path, report.files):
            archive.write(file, file.name)
    return {"file": str(path), "report": report}


def analyse_model(progress: Progress, directory: Path, prefix: str) -> dict[str, Any]:
    """Verdict and advice of dr-start-loganalysis."""
    from drcli.analysis.analysis import analyse
    from drcli.analysis.outputs import write_report
    from drcli.analysis.read_run import read_run
    from drcli.analysis.report_place import report_file

    settings = settings_for(directory, prefix)
    progress("Reads traces, metrics and evaluations.")
    analysis = analyse(read_run(settings, prefix))
    progress("Writes the report.")
    report = write_report(report_file(directory, prefix), analysis)
    return {
        "verdict": report.verdict,
        "advice": report.advice,
        "world": report.world,
        "episodes": report.episodes,
        "complete_laps": report.complete_laps,
        "best_lap_s": report.best_lap_s,
        "limit": report.limit,
        "problems": report.problems,
    }


def start_training(
    progress: Progress, directory: Path, prefix: str, max_minutes: float | None
) -> dict[str, Any]:
    from drcli.runs.plan import StartOptions
    from drcli.runs.track_fetch import fetch_allowed

    settings = settings_for(directory, prefix)
    fetch_allowed(settings)
    options = StartOptions(resume=True, max_minutes=max_minutes)
    return start_work.start_training(progress, settings, options, fetches=False)


def start_evaluation(
    progress: Progress, directory: Path, prefix: str, flags: dict[str, str]
) -> dict[str, Any]:
    from drcli.runs.evaluation import launch_evaluation
    from drcli.runs.evaluation_plan import prepare_evaluation
    from drcli.runs.track_fetch import fetch_allowed

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
    wish: dict[str, Any],
    path: Path | None,
) -> dict[str, Any]:
    """Film an evaluation as dr-video does, and put the film beside its trace.

    `wish` has fields of `drcli.video.make_video.Wish`; `path`: a film to download instead.
    """
    import tempfile

    from drcli.models.transfer_buckets import bucket_to_look_at
    from drcli.store import keys
    from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
    from drcli.video.encode import require_encoder
    from drcli.video.make_video import USUAL_SECONDS, Wish, frames_of
    from drcli.video.trace_source import trace_of_evaluation
    from drcli.video.video_job import Defaults, make_video

    require_encoder()
    settings = settings_for(directory, prefix)
    bucket = bucket_to_look_at(settings.transfer, upload=False)
    trace = trace_of_evaluation(bucket, prefix, stamp)
    defaults = Defaults.of(settings.model, settings.race)

    def film(target: Path) -> Any:
        wanted = Wish(**{"racer": "", "color": "", "most_seconds": USUAL_SECONDS, **wish})
        progress(f"Filming {frames_of(trace, wanted)} frames ...")
        return make_video(defaults, lambda: bucket, trace, wanted, [("film", target)])

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
    from drcli.models.upload import UploadOptions, plan_upload, upload

    settings = settings_for(directory, prefix)
    options = UploadOptions(choice, prefix=prefix, to=to or None, local=local)
    planned = plan_upload(settings, options)
    return upload(planned, settings, _bars(progress))


def import_archive(
    progress: Progress, directory: Path, source: Path, prefix: str, world: str | None
) -> Any:
    from drcli.config.loading import load_settings
    from drcli.models.download import download, plan_download
    from drcli.models.find_checkpoint import OwnModel
    from drcli.models.import_model import copy_of_own, import_model, plan_import
    from drcli.models.imported_model import ImportOptions

    settings = load_settings(directory)
    progress("Reads and compares the model.")
    options = ImportOptions(str(source), prefix, world=world)
    try:
        planned = plan_import(settings, options)
    except OwnModel:
        copy = plan_download(settings, copy_of_own(settings, options))
        return download(copy, settings, _bars(progress))
    return import_model(planned, settings, _bars(progress))


def delete_model(progress: Progress, directory: Path, prefix: str, forget: bool) -> Any:
    from drcli.config.loading import load_settings
    from drcli.runs.model_removal import plan_removal, remove_models

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
