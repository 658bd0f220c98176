"""The keys of every --json report, taken from the dataclasses behind them."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from typing import Any, get_args, get_type_hints

from drcli.base.errors import Problem

REPORTS: Mapping[str, tuple[str, ...]] = {
    "models.action_space_change:ActionSpaceReport": (
        "action-space show",
        "action-space generate",
        "action-space from-lap",
        "action-space from-histogram",
    ),
    "config.presets:PresetReports": ("config preset",),
    "runs.status:RunReport": ("start-training", "status"),
    "runs.stopping:StopReport": (
        "stop-training",
        "stop-evaluation",
        "stop-all",
        "stop-loganalysis",
        "logs-loganalysis",
    ),
    "runs.join_training:JoinReport": ("start-worker",),
    "sweeps.sweep_report:SweepReport": ("sweep start", "sweep show"),
    "sweeps.sweep_report:SweepList": ("sweep list",),
    "sweeps.start_sweep:SweepPlanned": ("sweep start --dry-run",),
    "runs.tensorboard_server:MetricsReport": ("start-metrics",),
    "cli.stopped_process:StoppedProcess": ("stop-metrics", "stop-viewer"),
    "web.viewer_process:ViewerReport": ("start-viewer", "update-viewer", "console"),
    "cli.commands.viewer:StreamReport": ("view-stream",),
    "saliency.explain_model:SaliencyReport": ("saliency",),
    "runs.journal_reader:JournalReport": ("journal",),
    "analysis.analysis:AnalysisReport": ("analyze",),
    "analysis.compare_runs:Comparison": ("analyze compare",),
    "cli.commands.loganalysis:ReportAddress": ("start-loganalysis", "url-loganalysis"),
    "models.training_list:TrainingList": ("history list",),
    "models.training_details:TrainingDetails": ("history show",),
    "models.training_comparison:TrainingComparison": ("history compare",),
    "models.family_tree:FamilyTree": ("history tree",),
    "models.training_details:ForgottenTrainings": ("history forget",),
    "explain.explanation:Explanation": ("explain",),
    "runs.foreign_watch:WatchReport": ("spot watch",),
    "cli.commands.spot_create:BaseReport": ("spot create-base",),
    "spot.creation:CreatedStack": ("spot create",),
    "cli.views.spot_view:Planned": ("spot create --dry-run",),
    "cli.commands.spot_create:AccessReport": ("spot add-access", "spot subscribe"),
    "spot.stack_report:StackReports": ("spot list",),
    "spot.prices:Offers": ("spot prices",),
    "spot.machine_cost:StackCost": ("spot cost",),
    "spot.stack_end:StoppedStack": ("spot stop", "spot delete"),
    "cli.commands.spot_end:DeletedBase": ("spot delete --keep-bucket",),
    "runs.increment:Increment": ("increment-training",),
    "runs.evaluation_report:EvaluationReport": ("evaluate", "start-evaluation"),
    "races.race_report:RaceReport": (
        "race create",
        "race show",
        "race edit",
        "race withdraw",
        "race move",
        "race restart",
        "race run",
        "race open",
        "race close",
        "start-tournament",
    ),
    "races.race_report:RaceList": ("race list",),
    "races.submissions:SubmissionReport": ("race submit",),
    "races.queue_process:QueueStarted": ("race run -q", "start-tournament -q"),
    "races.queue_process:QueueStopped": ("race stop",),
    "races.race_export:ExportedRace": ("race export",),
    "races.organise:DeletedRace": ("race delete",),
    "video.video_report:VideoReport": ("video",),
    "exchange.robust_result:RobustResult": ("evaluate --robust",),
    "runs.laps_report:LapsReport": ("evaluate --laps",),
    "runs.many_evaluations:TableReport": ("evaluate --models", "evaluate --worlds"),
    "runs.evaluation_loop:LoopReport": ("evaluate --loop",),
    "cli.commands.evaluate:Started": ("start-evaluation -q",),
    "runs.summary:Summary": ("summary",),
    "runs.process_list:ProcessReport": ("find-sagemaker", "find-robomaker"),
    "runs.process_list:SpeedReport": ("get-robomaker-stats",),
    "cli.commands.send_message:MessageReport": ("send-message",),
    "models.upload:UploadReport": ("upload-model",),
    "models.upload_prefix:UploadIncrement": ("increment-upload-model",),
    "models.download:DownloadReport": ("download-model",),
    "models.imported_model:ImportedModel": ("import",),
    "models.export_car:CarReport": ("export car", "upload-car-zip"),
    "models.export_car:ArchiveReport": ("export car --check",),
    "models.export_checkpoint:ExportReport": ("export tf-checkpoint", "export droa"),
    "models.export_forms:FormReport": (
        "export pb",
        "export onnx",
        "export tflite",
        "export openvino",
    ),
    "models.model_list:ModelList": ("list-models", "list-aws-models"),
    "models.checkpoint_list:CheckpointList": ("list-checkpoints",),
    "models.model_notes:NoteList": ("note add", "note list", "note edit", "note remove"),
    "runs.model_removal:RemovalReport": ("delete-model",),
    "runs.tidy:TidyReport": ("tidy",),
    "cli.views.droa_view:SignedIn": ("droa-login",),
    "cli.views.droa_view:SignedOut": ("droa-logout",),
    "cli.views.droa_view:RemoteModels": ("droa-list-models",),
    "remote.droa_metrics:ModelReport": ("droa-get-model",),
    "remote.droa_import:ImportReport": ("droa-import-model",),
    "remote.droa_download:DownloadedAsset": ("droa-download-logs",),
    "remote.droa_delete:DeletedModel": ("droa-delete-model",),
    "cli.commands.increments:UploadName": ("set-upload-model",),
    "cli.views.car_view:CarLoginReport": ("car login",),
    "cli.views.car_view:CarLogoutReport": ("car logout",),
    "remote.car_models:CarUpload": ("car upload",),
    "remote.car_models:CarModels": ("car list",),
    "remote.car_models:CarLoad": ("car load",),
    "remote.car_driving:CarDrive": ("car start", "car stop"),
    "remote.car_driving:CarSpeed": ("car speed",),
    "remote.car_status:CarStatus": ("car status",),
    "models.copy_custom_files:CustomFilesReport": ("upload-custom-files", "download-custom-files"),
    "config.write_folder:FolderReport": ("init",),
    "config.settings_report:Values": ("config show",),
    "checks.config_check:FullCheck": ("config check",),
    "config.editing:Edit": ("config set",),
    "checks.check_report:Report": ("validate",),
    "checks.doctor.findings:DoctorReport": ("doctor",),
    "benchmark.machine_benchmark:BenchReport": ("bench",),
    "runs.support_bundle:BundleReport": ("support-bundle",),
    "cli.commands.validate:Checked": ("update", "update-env", "reload"),
    "runs.addresses:Addresses": ("url",),
    "cli.completion:Installed": ("completion install",),
    "tracks.track_facts:TrackList": ("tracks list",),
    "tracks.tracks_folder:TrackView": ("tracks show",),
    "workers.racer_limit:FastestLine": ("tracks line", "tracks limit"),
    "tracks.track_facts:TrackFacts": ("tracks add", "tracks fetch"),
    "rewards.check:RewardReport": ("reward check",),
    "rewards.plot:PlotReport": ("reward plot",),
    "rewards.compare:ComparisonReport": ("reward compare",),
}
"""Each report, as `module:class` below `drcli`, with the commands that print it."""

_ATTRIBUTE = re.compile(r"^ {8}(\w+): (.+(?:\n {12,}\S.*)*)", re.MULTILINE)


def keys_of(report: str) -> list[tuple[str, str]]:
    """Keys of a report and what each means; those of a report inside it as `outer.inner`.

    Args:
        report: As in REPORTS.

    Raises:
        KeyError: One is not described.
    """
    module, _, name = report.partition(":")
    found = getattr(import_module(f"drcli.{module}"), name)
    properties = (
        (name, _sentence(value.__doc__ or ""))
        for name, value in vars(found).items()
        if isinstance(value, property)
    )
    return [*_fields(found, "", ()), *properties]


def _fields(report: Any, path: str, outer: tuple[Any, ...]) -> Iterator[tuple[str, str]]:
    if report is Problem:
        yield from ((f"{path}{key}", meaning) for key, meaning in Problem.JSON_KEYS.items())
        return
    meanings = {
        name: _sentence(text)
        for kind in report.__mro__
        for name, text in _ATTRIBUTE.findall(kind.__doc__ or "")
    }
    types = get_type_hints(report)
    for field in fields(report):
        key = f"{path}{field.name}"
        yield key, meanings[field.name]
        inner, many = _dataclass_in(types[field.name])
        if inner is not None and inner not in (*outer, report):
            yield from _fields(inner, f"{key}[]." if many else f"{key}.", (*outer, report))


def _dataclass_in(annotation: Any) -> tuple[Any, bool]:
    """The dataclass that a value holds, and whether it holds many of them."""
    if is_dataclass(annotation):
        return annotation, False
    inner = next((part for part in get_args(annotation) if is_dataclass(part)), None)
    return inner, getattr(annotation, "__origin__", None) in (list, tuple)


def _sentence(text: str) -> str:
    """A docstring's text in one line, with the JSON word for None."""
    return re.sub(r"\bNone\b", "null", " ".join(text.split()))
