"""Runs and reports that exist only on paper, in place of processes, buckets and drives."""

import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drcli.analysis.analysis import AnalysisReport
from drcli.analysis.compare_runs import ComparedPair, ComparedRun, Comparison
from drcli.base.errors import Problem
from drcli.checks.bench.bucket_speed import BucketSpeed
from drcli.checks.bench.machine_benchmark import (
    BenchReport,
    BucketReport,
    TrainingEstimate,
    WorkSpeed,
)
from drcli.checks.bench.work_order import Rates, Ready
from drcli.checks.check_report import Report, Skipped
from drcli.checks.doctor.findings import DoctorReport, Finding
from drcli.cli.commands.spot_watch import WatchReport
from drcli.convert.car_rules import CarAction
from drcli.model import race_keys
from drcli.model.checkpoint_list import CheckpointList, ListedCheckpoint, MilestoneEntry
from drcli.model.files.custom_files import InputFile, Inputs
from drcli.model.model_list import CheckpointEntry, ModelEntry, ModelList
from drcli.outside.aws.creation import CreatedStack, Estimate, StackOptions
from drcli.outside.aws.machines import Machine, MachineCost, StackCost
from drcli.outside.aws.prices import Offer
from drcli.outside.aws.stack_end import StoppedStack
from drcli.outside.aws.stack_report import StackReport
from drcli.outside.aws.stacks import Stack
from drcli.outside.car.car_address import CarAddress, CarLogin
from drcli.outside.car.car_camera import CameraCheck
from drcli.outside.car.car_config import CarConfig, CarSetting
from drcli.outside.car.car_driving import CarDrive, CarSpeed, CarStatus
from drcli.outside.car.car_latency import CarLatency
from drcli.outside.car.car_models import CarLoad, CarModel, CarModels, CarUpload
from drcli.outside.droa.droa_api import read_model
from drcli.outside.droa.droa_import import ImportReport
from drcli.outside.droa.droa_metrics import PhaseMeans
from drcli.outside.droa.droa_races import DroaSubmission, RemoteRace, RemoteRaces
from drcli.races.organise import show_race
from drcli.races.queue_process import QueueStarted, QueueStopped
from drcli.races.race_records import DrivenCar, DrivenLap, RaceResult, RaceRules, RaceSubmission
from drcli.races.stored_race import put
from drcli.races.submissions import SubmissionReport
from drcli.records.evaluation_task import CarTrial, CarTrials, RobustCell, RobustResult
from drcli.records.job import Job
from drcli.records.run_record import log_file
from drcli.records.training_record import Pretrained
from drcli.rewards.check import DriverReport, Extreme, ParameterReport, RewardReport, TimeReport
from drcli.rewards.compare import ComparisonReport, DriverComparison, PlaceComparison
from drcli.rewards.pictures import PlotReport
from drcli.run import resume_or_start
from drcli.run.evaluation_loop import BestLap, LoopReport
from drcli.run.evaluation_report import EvaluationReport, TrialReport, compare, laps_report
from drcli.run.increment import Increment
from drcli.run.join_training import JoinReport
from drcli.run.journal import JournalEvent, JournalReport
from drcli.run.many_evaluations import BestStart, TableReport, TableRow, training_command
from drcli.run.plan import RunPlan, StartOptions
from drcli.run.status import RunReport
from drcli.run.stopping import Stopped, StopReport
from drcli.run.support_bundle import BundledFile, BundleReport
from drcli.run.tensorboard_server import MetricsReport, ServerRecord, Tool
from drcli.run.worker_processes import Process, SpeedReport
from drcli.sweeps.sweep_record import SweepRecord, TrialRecord, TrialScore
from drcli.sweeps.sweep_report import SweepList, report_of
from drcli.tracks.track_facts import TrackFacts, TrackList
from drcli.transfer.copy_custom_files import CustomFilesReport
from drcli.transfer.download import DownloadReport
from drcli.transfer.export_car import CarReport
from drcli.transfer.export_forms import ExportReport, FormReport
from drcli.transfer.export_model import ExportTarget
from drcli.transfer.import_model import ImportedModel
from drcli.transfer.model_notes import NoteEntry, NoteList
from drcli.transfer.model_removal import PlannedRemoval, RemovalReport, RemovedModel
from drcli.transfer.tidy import TidyItem, TidyReport
from drcli.transfer.training_list import KnownTrainings
from drcli.transfer.upload import UploadIncrement, UploadReport
from drcli.view.saliency.explain_model import ExplainedStep, SaliencyReport
from drcli.view.video.make_video import FilmedEpisode, VideoReport
from drcli.web.viewer_process import ViewerRecord, ViewerReport
from memory_bucket import MemoryBucket
from past_trainings import child, training

MODEL = "a-team-with-a-long-name/oval-" + "x" * 40 + "-17"
URL = f"s3://bucket/{MODEL}"
DROA_ID = "2w7R6h2PNexQ9kC"
DROA_SITE = "https://deepracer-on-aws.example.com"
TRACK = "a_track_with_a_name_that_no_small_terminal_has_room_for"


ANALYSIS = AnalysisReport(
    model=MODEL,
    origin=URL,
    layout="drfc",
    world=TRACK,
    track_length_m=17.7,
    parent=None,
    workers=1,
    episodes=40,
    steps=1_234_567,
    complete_laps=2,
    best_lap_s=12.345,
    iterations=[
        {
            "iteration": n,
            "mean_reward": 10.0 * n,
            "mean_progress": 50.0,
            "complete_laps": n,
            "best_lap_s": 12.345 if n else None,
            "eval_mean_progress": None,
            "second_clean": None,
        }
        for n in range(2)
    ],
    learner=[],
    evaluations=[{"stamp": "2026", "summary": "1 of 1 lap clean, best 12.00 s"}],
    verdict={"kind": "converged", "sentence": "Converged since iteration 1.", "numbers": {}},
    advice=[
        {"id": "snaking", "title": "Snaking", "evidence": "It turns often.", "command": "dr-x"}
        for _ in range(3)
    ],
    findings={},
    hyperparameters={},
    machine_hours=None,
    cost_usd=None,
    problems=["0-iteration.csv has a damaged row in line 12. The other rows are analysed."],
)

_COMPARED = ComparedRun(
    model=MODEL,
    origin=URL,
    world=TRACK,
    iterations=20,
    episodes=400,
    steps=1_234_567,
    wall_s=7200.0,
    machine_hours=2.0,
    cost_usd=0.5,
    complete_laps=3,
    best_lap_s=12.3,
    late_iterations=5,
    late_reward=10.0,
    late_progress=80.0,
    late_lap_share=50.0,
    late_lap_s=13.0,
    first_lap_steps=1000,
    goals=[{"progress": 50.0, "iteration": 1, "steps": 1000.0, "wall_s": 1.0, "usd": None}],
    curve={},
)

COMPARISON = Comparison(
    [_COMPARED, _COMPARED],
    [
        ComparedPair(
            MODEL,
            {"difference": 20.0, "low": 10.0, "high": 30.0, "beyond_chance": True},
            None,
            None,
            None,
            "It drives further; this is more than chance.",
            {"settings": "--- a\n+++ b\n@@ -1 +1 @@\n-DR_X=1\n+DR_X=2"},
            same_reward=True,
        )
    ],
    {"steps": {"limit": 1000.0, "progress": [10.0, 20.0]}},
)


class PaperRun:
    """Stands in for drcli.run: takes what the commands ask, answers what a test has laid down.

    Attributes:
        looks: What is seen at each look from the launch on; the last one stays. An exception is
            raised instead, as Ctrl-C would be.
        between: Called before the last look, when something is to happen meanwhile.
        asked: Names of the functions called, in order.
    """

    PID = 4242

    def __init__(self, folder: Path, before: RunReport) -> None:
        self.folder = folder
        self.reset(before)

    def reset(self, before: RunReport) -> None:
        """Forget what was asked, with this run to be seen before anything starts."""
        self.before = before
        self.looks: list[RunReport | BaseException] = []
        self.between: Callable[[], object] | None = None
        self.asked: list[str] = []
        self.options: StartOptions | None = None
        self.refusal: Exception | None = None
        self.warnings: list[str] = []
        self.wiped = False
        self.running = True
        self.lingers = False
        self._started = False

    def prepare(self, settings: Any, options: StartOptions) -> RunPlan:
        self.asked.append("prepare")
        self.options = options
        if self.refusal is not None:
            raise self.refusal
        job = Job(settings.run, "abc", 7, None, settings.directory / "data", 1)
        names = ("reward_function.py", "hyperparameters.json", "model_metadata.json")
        files = (InputFile(name, b"", f"custom_files/{name}") for name in names)
        return RunPlan(job, Inputs(*files), self.warnings, None, "Ends some day.", wiped=self.wiped)

    def launch(self, plan: RunPlan) -> int:
        self.asked.append("launch")
        self._started = True
        return self.PID

    def supervise_job(self, job: Job) -> int:
        self.asked.append("supervise_job")
        self._started = True
        return 0

    def stop(self, config: Any) -> RunReport:
        self.asked.append("stop")
        self.running = self.lingers
        return self.inspect(config)

    def is_running(self, config: Any) -> bool:
        return self.running

    def inspect(self, config: Any, reader: object = None, *, anywhere: bool = False) -> RunReport:
        if reader is None and not self._started and "stop" not in self.asked:
            return self.before  # who follows a training brings a reader
        if len(self.looks) == 1 and self.between is not None:
            self.between()
            self.between = None
        look = self.looks.pop(0) if len(self.looks) > 1 else self.looks[0]
        if isinstance(look, BaseException):
            raise look
        return look


@pytest.fixture
def run(
    working_folder: Path, make_report: Callable[..., RunReport], monkeypatch: pytest.MonkeyPatch
) -> PaperRun:
    """The run of the working folder, with nothing started yet."""
    paper = PaperRun(working_folder, make_report("none", pid=None))
    # What takes it by its name, if it was first loaded now, would keep the paper one.
    assert resume_or_start.prepare
    monkeypatch.setattr("drcli.run.plan.prepare", paper.prepare)
    for name in ("launch", "supervise_job"):
        monkeypatch.setattr(f"drcli.run.training.{name}", getattr(paper, name))
    for name in ("stop", "is_running"):
        monkeypatch.setattr(f"drcli.run.stopping.{name}", getattr(paper, name))
    monkeypatch.setattr("drcli.run.status.inspect", paper.inspect)
    monkeypatch.setattr("drcli.cli.follow_training.POLL_S", 0.0)
    return paper


@pytest.fixture
def log(working_folder: Path) -> Callable[[str], Path]:
    """Path of a worker's log, its folder made."""

    def path_of(worker: str) -> Path:
        path = log_file(working_folder, "model", worker)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    return path_of


@pytest.fixture
def paper_reports(
    run: PaperRun,
    evaluation_report: EvaluationReport,
    make_report: Callable[..., RunReport],
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[[], None]:
    """Reports with long names in place of what takes servers, time or a model.

    To call it lays them down anew, for the next command that changes them.
    """

    def lay_down() -> None:
        run.reset(make_report("running", 12, prefix=MODEL))
        run.looks = [make_report("finished", 12, prefix=MODEL)]
        monkeypatch.setattr("drcli.run.evaluation.evaluate", lambda *_, **__: evaluation_report)
        _lay_down(run.folder, monkeypatch)
        joined = JoinReport(f"s3://bucket/{MODEL}", "The training is complete.", 0, took_over=False)
        monkeypatch.setattr("drcli.run.join_training.join_training", lambda *_, **__: joined)
        _lay_down_sweep(run.folder, monkeypatch)
        report = run.folder / "report.html"
        report.touch()
        monkeypatch.setattr("drcli.cli.commands.loganalysis.report_file", lambda *_: report)
        _lay_down_evaluations(monkeypatch)
        _lay_down_video(monkeypatch)
        _lay_down_droa(run.folder, monkeypatch)

    lay_down()
    return lay_down


def _lay_down_sweep(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sweep of three trainings, one of which has failed."""
    (folder / "sweep.yaml").write_text(
        "name: pace\nvary: {hyperparameters: {lr: [1e-4, 3e-4, 0.001]}}\nbudget: {minutes: 20}\n"
    )
    score = TrialScore(8, 5, 5, 100.0, 12.345, 345.6)
    trials = [
        TrialRecord("pace-01", "pace-01", 1, {"lr": "0.0001"}, "failed", message="Broken."),
        TrialRecord("pace-02", "pace-02", 2, {"lr": "0.0003"}, "finished", amount=20, score=score),
        TrialRecord("pace-03", "pace-03-g2", 3, {"lr": "0.001"}, "stopped early", amount=5.0),
    ]
    record = SweepRecord("pace", "lap_time", "minutes", 20, 1.0, tuple(trials), 2, 9.0, "pace-02")
    monkeypatch.setattr("drcli.sweeps.start_sweep.SweepRun.run", lambda *_: record)
    monkeypatch.setattr("drcli.sweeps.stored_sweep.read_sweep", lambda *_: record)
    found = SweepList("bucket", [report_of(record, "bucket")])
    monkeypatch.setattr("drcli.sweeps.sweep_report.list_sweeps", lambda *_: found)


def race_bucket() -> MemoryBucket:
    """A bucket with two races: with one submission in each state, and with a pair."""
    bucket = MemoryBucket()
    rules = RaceRules("Cup", 1.0, "reinvent_base", settings={"DR_SIM_LATENCY": "0.05"})
    put(bucket, race_keys.rules("cup"), replace(rules, max_submissions=2))
    put(bucket, race_keys.rules("duel"), replace(rules, name="Duel", race_type="HEAD_TO_MODEL"))
    names = [f"{number:018d}-{number:08x}" for number in range(0xAA, 0xAF)]
    racers = ("Ann", "Bob", "Cem", "Dan", "Ann")
    for name, racer in zip(names, racers, strict=True):
        record = RaceSubmission(racer, MODEL, "8_Step-4000.ckpt", 1.0)
        put(bucket, race_keys.submission("cup", name), record)
    laps = [DrivenLap(12.345, 100.0, "Lap complete"), DrivenLap(3.0, 40.0, "Off track", 1)]

    def done(*cars: DrivenCar) -> RaceResult:
        note = "The laps have no video, for a reason."
        return RaceResult("done", "a", 0, 1.0, 2.0, list(cars), notes=[note])

    for name, driven in ((names[0], laps), (names[1], laps[1:])):
        car = DrivenCar(name, driven, video=race_keys.video("cup", name))
        put(bucket, race_keys.result("cup", name), done(car))
    failed = RaceResult("failed", "a", 0, 1.0, 2.0, message="It ended.", remedy="Read its log.")
    put(bucket, race_keys.result("cup", names[2]), failed)
    for name in names[:2]:
        record = RaceSubmission(f"The racer {name[-1]}", MODEL, "8_Step-4000.ckpt", 1.0)
        put(bucket, race_keys.submission("duel", name), record)
    pair = done(DrivenCar(names[0], laps), DrivenCar(names[1], laps[1:]))
    put(bucket, race_keys.result("duel", "_".join(names[:2])), pair)
    return bucket


def _lay_down_video(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a video be made of a trace that does not exist."""
    trace = SimpleNamespace(origin="a-folder/a-trace-with-a-long-name.csv", stem="video")
    monkeypatch.setattr("drcli.view.video.trace_source.trace_of_file", lambda path: trace)
    laps = [
        FilmedEpisode(0, 15.867, 100.0, "Lap complete", 0),
        FilmedEpisode(12, 1234.5, 71.25, "Off track", 120),
    ]
    made = VideoReport(
        f"{MODEL.replace('/', '-')}-20260102030405.gif",
        1250.4,
        18756,
        1280,
        720,
        15,
        "reinvent_base",
        trace.origin,
        MODEL,
        "8_Step-4000.ckpt",
        "raycast",
        laps,
        ["A note."],
    )
    monkeypatch.setattr("drcli.view.video.make_video.plan_of", lambda *_: "Filming ...")
    monkeypatch.setattr("drcli.view.video.video_job.make_video", lambda *_, **__: made)


def _lay_down_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let several evaluations answer with a table, or with the grid or laps that are asked for."""
    cells = [
        RobustCell("none", "none", 4, 4, 100.0, 13.2),
        RobustCell("steering trim", "+8 deg", 4, 0, 20.0, None, "Off track"),
    ]
    grid = RobustResult(MODEL, "8_Step-4000.ckpt", "reinvent_base", 0, cells, 9.0)
    row = TableRow(MODEL, "8_Step-4000.ckpt", "reinvent_base", 3, 3, 100.0, 9.5, 9.75, clean=3)
    reason = TableRow(MODEL, "", "reinvent_base", reason=f"{URL} has no trained model.")
    best = BestStart("reinvent_base", MODEL, "8_Step-4000.ckpt", training_command(MODEL, "x"))
    table = TableReport([row, reason], [best], "comparisons/comparison-20260102030405.json")
    one = replace(table, rows=[replace(row, robust_score=60.0)], robust=[grid])
    trials = [
        TrialReport(1, 100.0, 9.5, "Lap complete", 0, 0, 0, 0.0, 0.0, 0.05, -2.5, 0),
        TrialReport(2, 100.0, 9.75, "Lap complete", 0, 0, 0, 0.0, 0.0, 0.05, -2.5, 0),
        TrialReport(3, 31.0, 4.0, "Off track", 1, 0, 0, 0.0, 0.6, -0.05, 2.5, 107),
    ]
    where = {"world": "reinvent_base", "simtrace": "trace.csv", "metrics": "metrics.json"}
    driven = {"prefix": MODEL, "seed": 0, "runtime": "torch", "file": None, **where}
    first = laps_report(trials, checkpoint="8_Step-4000.ckpt", **driven)
    second = laps_report([trials[0], trials[2], trials[2]], checkpoint="9_Step-4500.ckpt", **driven)
    sample = replace(first, against=second, comparison=compare(first, second))
    fresh = replace(table, rows=[row], laps=[sample])
    lap = BestLap("reinvent_base", "8.ckpt", 9.5, None, 2, 3, "2026-01-02T03:04:05", "2" * 14)
    loop = LoopReport(MODEL, "reinvent_base", 2, 1, [lap, lap], "best-laps.json")
    monkeypatch.setattr(
        "drcli.run.many_evaluations.prepare_many",
        lambda *_, robust, fresh_laps, **__: one if robust else fresh if fresh_laps else table,
    )
    monkeypatch.setattr("drcli.run.many_evaluations.run_many", lambda answer, _: answer)
    monkeypatch.setattr("drcli.run.evaluation_loop.run_loop", lambda *_, **__: loop)


def _lay_down(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the packages behind the commands answer with them."""
    (folder / "run.env").write_text(
        f'DR_WORLD_NAME=reinvent_base\nDR_LOCAL_S3_MODEL_PREFIX="{MODEL}"\n'
        "DR_HOST_X=True\nDR_UPLOAD_S3_BUCKET=uploads\n"
    )
    steps = "".join(f"0,{k % 9},1,{k},in_progress\n" for k in range(1, 100))
    (folder / "lap.csv").write_text(
        f"episode,steer,throttle,progress,episode_status\n{steps}0,0,2,100,lap_complete\n"
    )
    (folder / "model_metadata.json").write_text(
        '{"action_space": [{"steering_angle": 0, "speed": 2}], "sensor": ["observation"]}'
    )
    monkeypatch.setenv("HOME", str(folder / "home"))
    monkeypatch.setattr("drcli.cli.commands.url.settings", _settings)

    def answer(name: str, report: object) -> None:
        monkeypatch.setattr(f"drcli.{name}", lambda *_, **__: report)

    files = [f"a-folder/a-file-with-a-long-name-{k}.data-00000-of-00001" for k in range(3)]
    source = {"source": URL, "checkpoint": "8_Step-4000.ckpt", "copied": files}
    plan = {"source_url": URL, "target_url": URL, "used": 0, "chosen": SimpleNamespace(line="c")}
    answer("transfer.upload.plan_upload", SimpleNamespace(**plan))
    answer(
        "transfer.upload.upload",
        UploadReport(**source, target=URL, choice="last", metric=1.0, older=files, deleted=files),
    )
    answer("outside.messages.open_channels", [object()])
    topic = "the SNS topic arn:aws:sns:us-east-1:123456789012:a-topic-with-a-long-name"
    answer("outside.messages.try_channels", {topic: None})
    options = SimpleNamespace(prefix="model")
    answer("transfer.download.plan_download", SimpleNamespace(**plan, options=options))
    answer("transfer.download.download", DownloadReport(**source, target=URL, custom_files=files))
    imported = ImportedModel(
        **source,
        target=URL,
        form="frozen graph",
        network="DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
        num_actions=12,
        action_space_type="discrete",
        sensors=["FRONT_FACING_CAMERA"],
        world=TRACK,
        taken=files,
        shipped=files,
        fresh=["The optimizer starts with an empty state."],
        verified=["Both networks gave the same results for the same pictures."],
        warnings=["A file was corrected."],
        custom_files=files,
    )
    planned = SimpleNamespace(report=imported, used=3, options=options)
    answer("transfer.import_model.plan_import", planned)
    answer("transfer.import_model.import_model", imported)
    cars = [
        CarTrial("release-6", 0, 16, 12.345, []),
        CarTrial("low-grip", 16, 16, 100.0, [7.123, 8.0]),
    ]
    answer("run.car_trials.settings_of_model", None)
    answer("run.car_trials.try_cars", CarTrials(TRACK, cars, "low-grip", "release-6"))
    exported = SimpleNamespace(source=SimpleNamespace(chosen=SimpleNamespace(line="c")))
    export = ExportReport(
        **{"source": URL, "checkpoint": "8_Step-4000.ckpt", "target": URL, "files": files},
        **{"size_bytes": 123_456_789, "archive": f"{folder}/model.tar.gz"},
        **{key: ["A sentence about it."] for key in ("notes", "verified", "not_verified")},
    )
    form = FormReport(
        "onnx",
        MODEL,
        "8_Step-4000.ckpt",
        f"{folder}/a.onnx",
        [f"{folder}/a.onnx"],
        4000,
        "onnx",
        frames=32,
        same_actions=1.0,
        greatest_difference=2e-7,
    )
    answer("transfer.export_forms.plan_form", exported)
    answer("transfer.export_forms.export_form", form)
    answer("transfer.export_model.export_target", ExportTarget(f"{folder}/out", folder / "out"))
    for module, read, write in (
        # First the one that imports the other: it would keep an answer that is there already.
        ("export_droa", "read_droa_export", "export_droa"),
        ("export_forms", "read_checkpoint_export", "export_checkpoint"),
    ):
        answer(f"transfer.{module}.{read}", exported)
        answer(f"transfer.{module}.{write}", export)
    custom = CustomFilesReport(f"{folder}/custom_files", URL, files, files, [])
    answer("transfer.copy_custom_files.upload_custom_files", custom)
    answer("transfer.copy_custom_files.download_custom_files", custom)
    upload_step = UploadIncrement(f"{folder}/run.env", f"{folder}/run.env.bak", MODEL, MODEL)
    answer("transfer.upload.plan_upload_increment", SimpleNamespace(step=upload_step))
    answer("transfer.upload.make_upload_increment", None)
    weights = Pretrained(MODEL, "best", "8_Step-4000.ckpt", 1.0, "0")
    step = Increment("run.env", "run.env.bak", "bucket", MODEL, MODEL, weights, wipes=False)
    answer("run.increment.plan_increment", SimpleNamespace(step=step))
    answer("run.increment.make_increment", step)
    score = CheckpointEntry("8_Step-4000.ckpt", 87.54321)
    model = ModelEntry(MODEL, 4, score, score, 99, 123_456_789, "2026-01-02T03:04:05", True)
    answer("transfer.transfer_buckets.bucket_to_look_at", SimpleNamespace(name="bucket"))
    answer("model.model_list.list_models", ModelList("bucket", "", [model]))
    listed = ListedCheckpoint(
        8, "8_Step-4000.ckpt", ["last", "best", "first-lap"], True, 5, 2, 87.5, 12.34, 4_900_000
    )
    reached = MilestoneEntry("first-lap", "8_Step-4000.ckpt", 2, 5, 12.34, kept=False)
    answer(
        "model.checkpoint_list.list_checkpoints",
        CheckpointList(URL, [listed], [reached], ["three-laps"], 4_900_000),
    )
    text = "A note about wider kerbs that is longer than a narrow terminal has columns."
    notes = [
        NoteEntry(0, 1_000_000.0, 1_000_060.0, "host", None, text),
        NoteEntry(1, 1_000_000.0, None, "host", 12, text),
    ]
    for function in ("write_note", "list_notes", "rewrite_note", "delete_note"):
        answer(f"transfer.model_notes.{function}", NoteList(URL, notes))
    removed = RemovedModel(MODEL, 4, 99, 123_456_789, "2026-01-02T03:04:05", ["/logs/a.log"], 999)
    removal = RemovalReport("bucket", [removed], dry_run=False, size_bytes=123_456_789)
    answer("transfer.model_removal.plan_removal", PlannedRemoval(removal, (SimpleNamespace(),)))
    answer("transfer.model_removal.remove_models", removal)
    left = TidyItem("traces", MODEL, 12, 123_456, ["a"])
    tidied = TidyReport("bucket", [left], [MODEL], dry_run=False, size_bytes=123_456)
    answer("transfer.tidy.find_surplus", tidied)
    answer("transfer.tidy.tidy", tidied)
    worker = Process("trainer", 4243, True, "/logs/trainer.log")
    answer("run.worker_processes.trainers", [worker])
    text = "sim-0 was started again (restart 1), after a fault that takes a long sentence to tell."
    event = JournalEvent("abc", 1_000_000.0, "recovery", text, {"worker": "sim-0"})
    answer("run.journal.journal_of", JournalReport(URL, [event], []))
    for function in (
        "analysis.read_run.read_run",
        "analysis.read_run.read_runs",
        "analysis.analysis.analyse",
    ):
        answer(function, SimpleNamespace(name=MODEL))
    answer("analysis.outputs.check_targets", None)
    answer("analysis.outputs.write_outputs", ANALYSIS)
    answer("analysis.outputs.write_comparison_of", COMPARISON)
    first = training(0x1AB, MODEL)
    settings = {"DR_WORLD_NAME": TRACK, "DR_MODEL_DESCRIPTION": "Slow in the hairpin " * 4}
    clone = child(0x2FF, f"{MODEL}-2", first, hyperparameters={"batch_size": 512}, usd=12.5)
    clone = replace(clone, starts=(replace(clone.newest, settings=settings),))
    known = KnownTrainings("bucket", (first, clone), frozenset({clone.id}), frozenset())
    answer("transfer.training_list.known_trainings", known)
    races = race_bucket()
    # Wherever an earlier test has loaded them: a bucket of theirs would start a server.
    loaded = [module for key, module in sys.modules.items() if key.startswith("drcli.")]
    for module in loaded:
        for name in ("open_running_bucket", "open_bucket"):
            if name in vars(module):
                monkeypatch.setattr(module, name, lambda *_, **__: races)
    answer(
        "races.submissions.submit",
        SubmissionReport("cup", "000000aa", TRACK, MODEL, "8_Step-4000.ckpt", 2, 1, queue=False),
    )
    answer("races.race_queue.run_queue", show_race(races, "cup"))
    log = f"{folder}/data/logs/races/cup.log"
    answer("races.organise.change_rules", show_race(race_bucket(), "cup"))
    answer("races.queue_process.launch_queue", QueueStarted("cup", 4242, log))
    answer("races.queue_process.stop_queue", QueueStopped("cup", 4242))
    text = "EC2 announces that it will terminate this instance in 120 s."
    notice = WatchReport("aws", "interruption", "terminate", 120.0, text, 0)
    answer("cli.commands.spot_watch.cloud_of_machine", "aws")
    answer("cli.commands.spot_watch.ForeignWatch.once", notice)
    answer("run.worker_processes.simulations", [worker])
    answer("run.worker_processes.speed_of", SpeedReport("sim-0", 4243, 12, 1500, 412.3, 27.4))
    stopped = Stopped("evaluation", 0, URL, 4243)
    answer("run.stopping.stop_all", StopReport([stopped], server=True))
    answer("run.stopping.stop_evaluations", [stopped])
    size = {"length_m": 17.7, "width_m": 1.07, "least_width_m": 0.5, "greatest_width_m": 1.1}
    facts = TrackFacts(
        **{"name": TRACK, **size, "closed": True, "direction": "counterclockwise"},
        **{
            "waypoints": 119,
            "spacing_m": 0.15,
            "repeated": [17, 38],
            "line_family": "out",
            "source": "own",
        },
        **{"difficulty": "medium", "about": "Of a championship, with many bends and a long name"},
    )
    _answer_as_car(monkeypatch, answer)
    _answer_as_amazon(monkeypatch, answer)
    _answer_about_machine(folder, answer)
    exported = {"source": URL, "choice": "last", "checkpoint": "8_Step-4000.ckpt", "metric": 1.0}
    compared = {"world": TRACK, "frames": 200, "same_actions": 200, "greatest_difference": 1e-7}
    archive = CarReport(
        **exported,
        **compared,
        files=[f"{URL}/{name}" for name in files],
        size_bytes=23_456_789,
        actions=[CarAction(None, -17.25, 3.125, -0.575, 0.8125)],
    )
    chosen = SimpleNamespace(file_name="model", url=URL, chosen=SimpleNamespace(line="c"))
    answer("transfer.export_model.read_export_source", chosen)
    answer("checks.compare_on_drive.export_car", None)
    answer("transfer.export_car.plan_car_upload", SimpleNamespace(url=URL))
    answer("transfer.export_car.upload_names", files)
    answer("transfer.export_car.write_archive", archive)
    answer("transfer.export_car.upload_archive", archive)
    answer("cli.commands.tracks.list_tracks", TrackList(f"{folder}/tracks", [facts], []))
    answer("tracks.tracks_folder.add_track", facts)
    answer("tracks.community.fetch_track", facts)
    broken = Problem(
        "V-21",
        "error",
        "custom_files/reward_function.py",
        12,
        "It is wrong. " * 9,
        "Write it as it shall be. " * 5,
    )
    skipped = Skipped(
        ("V-10", "V-11"), "The bucket cannot be reached while the settings are wrong."
    )
    answer("checks.validate.validate", Report("", False, (broken,), (broken,), (skipped,)))
    answer("rewards.check.check", _reward_report())
    _answer_with_explanations(folder, answer)
    answer("rewards.pictures.plot", PlotReport("a.py", TRACK, TRACK, True, 0, 1, {"steady": 99.0}))
    answer("rewards.compare.compare", _comparison())


def _answer_with_explanations(folder: Path, answer: Callable[[str, object], None]) -> None:
    """Let the modules behind `dr saliency` and the commands for live figures answer."""
    step = ExplainedStep(
        **{"step": 12, "time_s": 0.8, "progress": 4.25, "x": 1.0, "y": 2.0, "action": 3},
        **{"steering_deg": -12.5, "speed_mps": 1.25},
        strongest={"perturbation": (40, 12)},
        greatest={"perturbation": 0.125},
        ninths={"perturbation": [[0.0, 0.0, 0.1], [0.7, 0.1, 0.0], [0.1, 0.0, 0.0]]},
        lidar=None,
        picture=f"{folder}/pictures/saliency-0012.png",
    )
    explained = SaliencyReport(
        **{"model": MODEL, "checkpoint": "8_Step-4000.ckpt", "world": TRACK, "target": "action"},
        **{"unit": "of the probability", "outcome": "Off track", "progress": 12.5},
        **{"seconds": 3.25, "html": f"{folder}/saliency.html"},
        steps=[step],
        lap={"step": [1, 2], "value": [0.5, 0.25]},
        notes=["A sentence about it."],
    )
    answer("view.saliency.explain_model.explain_checkpoint", (None, "8_Step-4000.ckpt"))
    answer("view.saliency.explain_model.write_page", None)
    answer("view.saliency.explain_model.report_of", explained)
    tools = [
        Tool("TensorBoard", "DR_TENSORBOARD", f"{folder}/data/tensorboard"),
        Tool("Grafana", "DR_TELEGRAF_HOST", ""),
    ]
    metrics = MetricsReport(
        "http://127.0.0.1:6006/", 4243, f"{folder}/data", [MODEL], tools, [MODEL]
    )
    answer("run.tensorboard_server.fetch_events", [MODEL])
    answer("run.tensorboard_server.write_histories", [MODEL])
    answer("run.tensorboard_server.start_tensorboard", metrics)
    answer("run.tensorboard_server.stop_tensorboard", ServerRecord(4243, 1.0, 6006))
    viewer = ViewerReport("http://127.0.0.1:8100/", 4243, "127.0.0.1", 8100, False, True)
    answer("web.viewer_process.start_viewer", viewer)
    record = ViewerRecord(4243, 1.0, "127.0.0.1", 8100)
    answer("web.viewer_process.stop_viewer", record)
    answer("web.viewer_process.running_viewer", record)


def _answer_as_car(monkeypatch: pytest.MonkeyPatch, answer: Callable[[str, object], None]) -> None:
    """Let the modules behind `dr car` answer."""
    monkeypatch.setenv("DR_CAR_PASSWORD", "secret")
    name = "a-model-with-a-long-name-" + "x" * 40
    models = [
        CarModel(name, True, "", "PPO", "Discrete", ["Single camera"], "12M"),
        CarModel("scan", False, "its sensor (LiDAR) is not connected", sensors=["LiDAR"]),
    ]
    page = SimpleNamespace(address=CarAddress("10.0.0.5"))
    answer("outside.car.car_web.first_login", (CarLogin("fingerprint", "ab" * 32), True))
    answer("outside.car.car_web.CarWeb.log_in", None)
    answer("outside.car.car_web.CarWeb.opened", page)
    answer("outside.car.car_models.check_file", SimpleNamespace(name="a-file"))
    answer("outside.car.car_models.list_models", CarModels("10.0.0.5", models))
    answer("outside.car.car_models.upload_model", CarUpload("10.0.0.5", name, 3_200_000, True, ""))
    answer("outside.car.car_models.load_model", CarLoad("10.0.0.5", name, 12.3))
    answer("outside.car.car_driving.refuse_without_model", None)
    answer("outside.car.car_driving.drive", CarDrive("10.0.0.5", False, 12.3))
    answer("outside.car.car_driving.stop", CarDrive("10.0.0.5", False))
    answer("outside.car.car_driving.set_speed", CarSpeed("10.0.0.5", 30))
    steering = CarSetting("steering.mode", "servo", ["servo", "diffdrive"])
    answer("outside.car.car_config.read_config", CarConfig("10.0.0.5", [steering]))
    seen = CameraCheck("10.0.0.5", "car-picture.jpg", "upright", 180, False)
    answer("outside.car.car_camera.check_camera", seen)
    late = CarLatency("10.0.0.5", "servo", 42.3, 55.1, 29.97)
    answer("outside.car.car_latency.asked_latency", late)
    sensors, metrics = {"camera": "connected", "lidar": "not_connected"}, {"fps_mean": 29.97}
    kept = {"camera.orientation": 180, "imu.enabled": True}
    status = CarStatus("10.0.0.5", "community", "2.1", "R2", 9, sensors, "loaded", metrics, kept)
    answer("outside.car.car_driving.read_status", status)


def _answer_as_amazon(
    monkeypatch: pytest.MonkeyPatch, answer: Callable[[str, object], None]
) -> None:
    """Let the modules behind `dr spot` answer."""
    region, bucket = "ap-southeast-2", "racing-bucket-1a2b3c4d5e6f"
    topic = f"arn:aws:sns:{region}:123456789012:racing"
    ours = SimpleNamespace(region=region, profile=None, bucket=lambda name: None)
    answer("cli.commands.spot.account", ours)
    tags = {"drcli:kind": "training", "drcli:model": MODEL, "drcli:bucket": bucket}
    stack = Stack("my-run", "CREATE_COMPLETE", 1.79e9, tags, {"Topic": topic})
    answer("cli.commands.spot.need_stack", stack)
    answer("cli.commands.spot.refuse_existing", None)
    made = SimpleNamespace(bucket=bucket, outputs={"Topic": topic})
    answer("cli.commands.spot.create_stack", made)
    kinds = ("c7i-flex.12xlarge", "m6id.metal")
    plan = SimpleNamespace(
        options=StackOptions("my-run", bucket, kinds),
        settings=SimpleNamespace(
            model_prefix=MODEL,
            upload_s3_bucket=bucket,
            upload_s3_prefix=f"upload/{MODEL}",
            custom_files=SimpleNamespace(folder=Path("no-files")),
        ),
        source=SimpleNamespace(shown="drcli==1.0.0"),
        types=[SimpleNamespace(name=name) for name in kinds],
        zones=(f"{region}a", f"{region}b"),
        estimate=Estimate(0.61, 0.72, 0.008, 12.0),
        resumes="8_Step-4000.ckpt",
        notes=("The model is there already; the training goes on.",),
        files={},
        not_imported="DR_DROA_URL is empty.",
    )
    answer("run.stack_plan.prepare", plan)

    def fetch_folder(_account: object, _stack: object, folder: Path, _environ: object) -> object:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "run.env").write_text(f"DR_LOCAL_S3_MODEL_PREFIX={MODEL}\n")
        return {}

    monkeypatch.setattr("drcli.outside.aws.stack_logs.fetch_folder", fetch_folder)
    created = CreatedStack(
        "my-run", region, bucket, MODEL, kinds, "spot", 0.61, 8.74, 1.79e9, topic
    )
    answer("outside.aws.creation.carry_out", created)
    answer("outside.aws.stacks.subscribe", None)
    answer("outside.aws.stacks.add_access", "203.0.113.7/32")
    names = ("i-0123456789abcdef0", "i-0fedcba9876543210")
    machines = (
        Machine(names[0], kinds[0], f"{region}a", "spot", "gone", "", "", 1.79e9, 1.790007e9, 0.61),
        Machine(names[1], kinds[1], f"{region}b", "spot", "running", "training", "", 1.790008e9, 0),
    )
    state = ("training", "CREATE_COMPLETE", "training", "A machine was taken away an hour ago.")
    running = ("8_Step-4000.ckpt", machines, 1.26, 1.79e9, 1.79004e9)
    base = StackReport(
        *("racing", "base", "CREATE_COMPLETE", "ready", "", "", bucket, "", (), None, 1.78e9, 0)
    )
    answer("cli.commands.spot.our_stacks", [stack, stack])
    reports = iter((StackReport("my-run", *state, MODEL, bucket, *running), base))
    monkeypatch.setattr(
        "drcli.outside.aws.stack_report.report_on", lambda *_, **options: next(reports)
    )
    answer("outside.aws.prices.read_advisor", None)
    answer("cli.commands.spot.find_types", [])
    offers = [
        Offer(kinds[0], region, f"{region}a", 0.6123, 14, "<5%"),
        Offer(kinds[1], region, f"{region}b", 12.3456, 40),
    ]
    answer("outside.aws.prices.offers_of", offers)
    answer("cli.commands.spot.read_marks", [])
    answer("outside.aws.machines.machines_of", machines)
    costs = [
        MachineCost(names[0], kinds[0], f"{region}a", "spot", 2.0, 0.62, 1.24),
        MachineCost(names[1], kinds[1], f"{region}b", "on-demand", 1.5, None, None),
    ]
    unknown = f"The price of {names[1]} is not known."
    answer("outside.aws.machines.cost_of", StackCost("my-run", costs, 0.0175, [unknown]))
    answer("outside.aws.stack_end.stop_training_there", names)
    answer("outside.aws.stack_end.verified_checkpoint", "8_Step-4000.ckpt")
    stopped = StoppedStack("my-run", MODEL, "8_Step-4000.ckpt", names, 12, whole=True)
    answer("outside.aws.stack_end.remove_training", stopped)


def _answer_about_machine(folder: Path, answer: Callable[[str, object], None]) -> None:
    """Let the modules behind `dr doctor` and `dr support-bundle` answer."""
    remedy = "Delete old logs, or choose a folder on a larger disk with DR_LOCAL_S3_DATA_DIR."
    findings = (
        Finding("Python", "ok", f"3.12.3 in {folder}/.venv", facts={"version": "3.12.3"}),
        Finding("memory", "warning", "2.1 GB are free; a worker takes 1.2 GB.", "Use fewer."),
        Finding("disk", "problem", f"{folder}/data has only 120 MB left.", remedy),
        Finding("upload bucket", "ok", f"{URL} can be read and written."),
    )
    answer("checks.doctor.diagnose.diagnose", DoctorReport(str(folder), 2.34, findings))
    ready = Ready(6.2, "cpu", "bf16", 2, 2, False, 20, 20, 3, 64, 2_433_000)
    rates = Rates(3812.4, 2177.0, 1088.5, 4120.0, 2060.0, 64.4, 31.0, 612_000_000, 7321.0)
    estimate = TrainingEstimate(702.3, 1.0, 1.5, 0.3, "learning", 0.53)
    network = "COMPACT_CONVOLUTIONAL_NETWORK"
    work = WorkSpeed("reinvent_base", "TIME_TRIAL", network, "clipped_ppo", ready, rates, estimate)
    report = BenchReport(
        702.3,
        str(folder),
        "Intel(R) Xeon(R) Processor",
        16,
        2,
        2,
        "low",
        25_000_000_000,
        9_000_000_000,
        1_500_000_000,
        {"python": "3.11.7", "torch": "2.13.0"},
        work,
        work,
        "",
        BucketReport(f"remote: {URL}", BucketSpeed(81.2, 143.9, 212.0, 4.6, 131, 1, 1)),
        [6.8, 9.1, 12.4],
        0.31,
        0.0,
        ["The machine is busy."],
        41.0,
    )
    answer("checks.bench.machine_benchmark.measure_machine", report)
    files = (
        BundledFile("README.txt", 612, 0),
        BundledFile(f"files/data/logs/sagemaker/{MODEL}/trainer.log", 1_048_576, 17),
    )
    removed = {"key of the bucket": 16, "password in an address": 1}
    left_out = (f"status.json: {URL} cannot be reached.",)
    target = f"{folder}/drcli-support-20261122-213000.tar.gz"
    bundle = BundleReport(target, 234_567, files, removed, 5, left_out)
    answer("run.support_bundle.make_bundle", bundle)


def _lay_down_droa(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A DeepRacer on AWS with one model."""
    values = {
        "modelId": DROA_ID,
        "name": "a-car-" + "x" * 50,
        "status": "READY",
        "trainingStatus": "COMPLETED",
        "createdAt": "2026-11-22T10:00:00.000Z",
        "fileSizeInBytes": 12_000_000,
        "metadata": {
            "hyperparameters": {"num_episodes_between_training": 20},
            "actionSpace": {"discrete": [{"speed": 1.0, "steeringAngle": -30}]},
            "rewardFunction": "def reward_function(params):\n    return 1.0\n",
        },
    }
    found = read_model(values, DROA_SITE)
    means = [PhaseMeans("training", 2, 20.0, 75.0, 1, 12.5)]
    session = SimpleNamespace(
        site=SimpleNamespace(place=DROA_SITE),
        username="me@example.com",
        renew=lambda: SimpleNamespace(expires=datetime(2026, 11, 22, tzinfo=UTC)),
        forget=lambda: True,
    )
    droa = SimpleNamespace(
        place=DROA_SITE,
        session=session,
        models=lambda: [found],
        find=lambda wanted: found,
        delete=lambda model_id: None,
    )
    race = RemoteRace(
        "2w7R6h2PNexQ9kD", "Spring", "TIME_TRIAL", "reinvent_base", True, "", 3, False
    )
    driven = DroaSubmission(DROA_SITE, "Spring", "car", 1, "COMPLETED", 31.25, 9.95, 3, 1)
    file = folder / "training-logs.tar.gz"
    file.write_bytes(b"logs")
    imported = ImportReport(DROA_SITE, DROA_ID, "car", "READY", 12, 12_000_000, "uploads/models/x")
    answers: dict[str, Callable[..., Any]] = {
        "cli.commands.droa.Connection.refuse_no_site": lambda _: None,
        "cli.commands.droa.Connection.session": lambda _: session,
        "cli.commands.droa.Connection.droa": lambda _: droa,
        "cli.commands.droa.read_package": lambda path: {},
        "outside.droa.droa_metrics.metrics_summary": lambda *_: means,
        "outside.droa.droa_import.plan_import": lambda *_, **__: None,
        "outside.droa.droa_import.import_files": lambda *_, **__: imported,
        "outside.droa.droa_races.list_races": lambda *_: RemoteRaces(DROA_SITE, [race]),
        "outside.droa.droa_races.submit": lambda *_: driven,
        "outside.droa.droa_download.find_asset": lambda *_: "",
        "outside.droa.droa_download.download": lambda *_, **__: file,
    }
    for name, answer in answers.items():
        monkeypatch.setattr(f"drcli.{name}", answer)


def _settings():
    """Settings whose bucket has an address on the web."""
    from drcli.config.loading import load_settings

    remote = {"DR_CLOUD": "remote", "DR_REMOTE_MINIO_URL": "http://a-long-name-of-a-server:9000"}
    return load_settings(Path.cwd(), flags=remote)


def _reward_report() -> RewardReport:
    remark = Problem("works", "error", "reward_function.py", 3, "It fails. " * 9, "Correct it.")
    return RewardReport(
        others=[],
        **{"file": "custom_files/reward_function.py", "world": TRACK, "race_type": "TIME_TRIAL"},
        **{"reversed": True, "calls": 2666, "returns": ["float"], "mean": 0.5},
        least=Extreme(0.001, "fast driver, step 97, 63.7 % of the lap, 0.33 m right of the centre"),
        greatest=Extreme(1.0, "standing driver, step 6, 1.0 % of the lap, 0.00 m right"),
        time=TimeReport(1.0, 1.0, 6.8, "somewhere", 0.4),
        parameters=[ParameterReport(f"parameter_{k}", 0.0, 1.0, k > 3) for k in range(27)],
        drivers=[DriverReport("steady", "", 226, 15.1, 100.0, "lap_complete", 202.5, 0.8959)],
        curve=[k / 200 for k in range(200)],
        errors=[remark],
        warnings=[remark],
        notes=[remark],
    )


def _comparison() -> ComparisonReport:
    return ComparisonReport(
        **{"first": "a.py", "second": "b.py", "world": TRACK, "race_type": "TIME_TRIAL"},
        **{"correlation": 0.5, "rank_correlation": 0.5, "picture": "both.png"},
        drivers=[DriverComparison("steady", "", 226, 15.1, 12345.0, 1.0, 98765.0, 1.0)],
        places=[PlaceComparison("63.7 % of the lap, 0.33 m right of the centre", 1.0, 0.0, 1.0)],
        **{"first_prefers_fast": True, "second_prefers_fast": False},
    )
