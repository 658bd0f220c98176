"""The keys of every --json report, and what its fields say about them."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from typing import Any, get_args, get_type_hints

from drcli.base.errors import Problem

REPORTS: Mapping[str, tuple[str, ...]] = {
    "transfer.action_space_change:ActionSpaceReport": (
        "action-space show",
        "action-space generate",
        "action-space from-lap",
        "action-space from-histogram",
    ),
    "config.presets:PresetReports": ("config preset",),
    "config.presets:Examples": ("reward examples",),
    "run.status:RunReport": ("start-training", "attach", "status", "spot status"),
    "run.stopping:StopReport": (
        "stop-training",
        "stop-evaluation",
        "stop-all",
        "stop-loganalysis",
        "logs-loganalysis",
    ),
    "run.join_training:JoinReport": ("start-worker",),
    "sweeps.sweep_report:SweepReport": ("sweep start", "sweep show"),
    "sweeps.sweep_report:SweepList": ("sweep list",),
    "sweeps.start_sweep:SweepPlanned": ("sweep start --dry-run",),
    "run.tensorboard_server:MetricsReport": ("metrics start",),
    "cli.stopped_process:StoppedProcess": ("metrics stop", "console stop"),
    "web.viewer_process:ViewerReport": (
        "console open",
        "console start",
        "console restart",
        "console status",
        "spot console",
    ),
    "cli.commands.viewer:StreamReport": ("console stream",),
    "view.saliency.explain_model:SaliencyReport": ("saliency",),
    "run.journal:JournalReport": ("journal",),
    "analysis.analysis:AnalysisReport": ("analyze",),
    "analysis.compare_runs:Comparison": ("analyze compare",),
    "cli.commands.loganalysis:ReportAddress": ("start-loganalysis", "url-loganalysis"),
    "transfer.training_list:TrainingList": ("history list",),
    "transfer.training_details:TrainingDetails": ("history show",),
    "transfer.training_details:TrainingComparison": ("history compare",),
    "transfer.family_tree:FamilyTree": ("history tree",),
    "transfer.training_details:ForgottenTrainings": ("history forget",),
    "checks.explain.lookup:Explanation": ("explain",),
    "cli.commands.spot_watch:WatchReport": ("spot watch",),
    "cli.commands.spot:BaseReport": ("spot create-base",),
    "outside.aws.creation:CreatedStack": ("spot create",),
    "outside.aws.creation:Planned": ("spot create --dry-run",),
    "cli.commands.spot:AccessReport": ("spot add-access", "spot subscribe"),
    "outside.aws.stack_report:StackReports": ("spot list",),
    "outside.aws.prices:Offers": ("spot prices",),
    "outside.aws.machines:StackCost": ("spot cost",),
    "outside.aws.stack_end:StoppedStack": ("spot stop", "spot delete"),
    "cli.commands.spot:DeletedBase": ("spot delete --keep-bucket",),
    "run.increment:Increment": ("increment-training",),
    "run.evaluation_report:EvaluationReport": ("evaluate",),
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
    "view.video.make_video:VideoReport": ("video",),
    "view.video.knob_strip:KnobReport": ("video --knobs",),
    "records.evaluation_task:RobustResult": ("evaluate --robust",),
    "run.evaluation_report:LapsReport": ("evaluate --laps",),
    "run.many_evaluations:TableReport": ("evaluate --models", "evaluate --worlds"),
    "run.evaluation_loop:LoopReport": ("evaluate --loop",),
    "cli.commands.evaluate:Started": ("start-evaluation -q",),
    "run.summary:Summary": ("summary",),
    "cli.commands.version:Versions": ("version",),
    "run.worker_processes:ProcessReport": ("find-sagemaker", "find-robomaker"),
    "run.worker_processes:SpeedReport": ("get-robomaker-stats",),
    "cli.commands.send_message:MessageReport": ("send-message",),
    "transfer.upload:UploadReport": ("upload-model",),
    "transfer.upload:UploadIncrement": ("increment-upload-model",),
    "transfer.download:DownloadReport": ("download-model",),
    "transfer.import_model:ImportedModel": ("import",),
    "transfer.export_car:CarReport": ("export car", "upload-car-zip"),
    "transfer.export_car:ArchiveReport": ("export car --check",),
    "transfer.export_forms:ExportReport": ("export tf-checkpoint", "export droa"),
    "transfer.export_forms:FormReport": (
        "export pb",
        "export onnx",
        "export tflite",
        "export openvino",
    ),
    "model.model_list:ModelList": ("list-models",),
    "model.checkpoint_list:CheckpointList": ("list-checkpoints",),
    "transfer.model_notes:NoteList": ("note add", "note list", "note edit", "note remove"),
    "transfer.model_removal:RemovalReport": ("delete-model",),
    "transfer.tidy:TidyReport": ("tidy",),
    "cli.commands.droa:SignedIn": ("droa login",),
    "cli.commands.droa:SignedOut": ("droa logout",),
    "cli.commands.droa:RemoteModels": ("droa list",),
    "outside.droa.droa_metrics:ModelReport": ("droa show",),
    "outside.droa.droa_import:ImportReport": ("droa import",),
    "outside.droa.droa_races:RemoteRaces": ("droa races",),
    "outside.droa.droa_races:DroaSubmission": ("droa submit",),
    "outside.droa.droa_download:DownloadedAsset": ("droa download",),
    "outside.droa.droa_download:DeletedModel": ("droa delete",),
    "cli.commands.increments:UploadName": ("set-upload-model",),
    "cli.commands.car:CarLoginReport": ("car login",),
    "cli.commands.car:CarLogoutReport": ("car logout",),
    "outside.car.car_models:CarUpload": ("car upload",),
    "outside.car.car_models:CarModels": ("car list",),
    "outside.car.car_models:CarLoad": ("car load",),
    "outside.car.car_driving:CarDrive": ("car start", "car stop"),
    "outside.car.car_driving:CarSpeed": ("car speed",),
    "outside.car.car_driving:CarStatus": ("car status",),
    "outside.car.car_config:CarConfig": ("car config",),
    "outside.car.car_camera:CameraCheck": ("car check",),
    "outside.car.car_latency:CarLatency": ("car latency",),
    "transfer.copy_custom_files:CustomFilesReport": (
        "upload-custom-files",
        "download-custom-files",
    ),
    "config.new_folder:FolderReport": ("init",),
    "config.settings_report:Values": ("config show",),
    "checks.config_check:FullCheck": ("config check",),
    "config.editing:Edit": ("config set",),
    "checks.check_report:Report": ("validate",),
    "checks.doctor.findings:DoctorReport": ("doctor",),
    "checks.bench.machine_benchmark:BenchReport": ("bench",),
    "run.support_bundle:BundleReport": ("support-bundle",),
    "cli.commands.validate:Checked": ("update",),
    "run.summary:Addresses": ("url",),
    "cli.completion:Installed": ("completion install",),
    "tracks.track_facts:TrackList": ("tracks list", "tracks fetch --all"),
    "tracks.tracks_folder:TrackView": ("tracks show",),
    "drive.racer_limit:FastestLine": ("tracks line", "tracks limit"),
    "tracks.track_facts:TrackFacts": ("tracks add", "tracks generate", "tracks fetch"),
    "rewards.check:RewardReport": ("reward check",),
    "rewards.pictures:PlotReport": ("reward plot",),
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
    types, hints = get_type_hints(report), get_type_hints(report, include_extras=True)
    meanings = {
        name: _sentence(text)
        for name, hint in hints.items()
        for text in getattr(hint, "__metadata__", ())
        if isinstance(text, str)
    } | {
        name: _sentence(text)
        for kind in report.__mro__
        for name, text in _ATTRIBUTE.findall(kind.__doc__ or "")
    }
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
