"""Lists the stored stand-alone evaluations of a model."""

import re
from dataclasses import dataclass, field

from drcli.base.json_record import RecordError, parse_json
from drcli.config.bucket_config import ModelConfig
from drcli.exchange.episode_metrics import TrialMetrics
from drcli.exchange.race_recording import RaceRecording
from drcli.runs.evaluation_report import (
    TrialReport,
    best_finished_s,
    laps_of,
    summary,
    trial_reports,
)
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, ObjectNewer, read_record
from drcli.store.remedies import remedy_of
from drcli.store.repair import Model
from drcli.store.training_records import at_once

MOST_EVALUATIONS = 200
_METRICS = re.compile(r"(?:EvaluationMetrics-|evaluation/(?:evaluation-)?)(\d{14})[^/]*\.json")


@dataclass(frozen=True)
class ListedEvaluation:
    """A stored evaluation; what nobody recorded is None or empty.

    Attributes:
        stamp: Its name, fourteen digits of its local time.
        best_lap_s: Fastest clean lap, simulated seconds.
        mean_lap_s: Of completed laps, penalties included.
        problem: Why its trials cannot be read.
        best_finished_s: Fastest completed lap, penalties included.
    """

    stamp: str
    world: str
    race_type: str
    reverse: bool | None
    checkpoint: str
    trials: list[TrialReport]
    complete_laps: int
    best_lap_s: float | None
    mean_lap_s: float | None
    off_track_penalty_s: float | None
    collision_penalty_s: float | None
    video: bool
    trace: bool
    problem: str = ""
    clean_laps: int = 0
    resets: int = 0
    best_finished_s: float | None = None
    summary: str = ""


@dataclass(frozen=True)
class EvaluationList:
    """The newest first, of `total`; `videos` such as `mp4/camera-pip/0-video.mp4`."""

    model: str
    evaluations: list[ListedEvaluation]
    total: int
    videos: list[str] = field(default_factory=list)


_VIDEO = re.compile(
    r"mp4/camera-(?:pip|45degree|topview)/\d{1,6}-video\.mp4|evaluation-\d{14}/video\.mp4"
)


def is_video(name: str) -> bool:
    return _VIDEO.fullmatch(name) is not None


def list_evaluations(config: ModelConfig, bucket: Bucket, prefix: str) -> EvaluationList:
    folder = keys.folder(prefix)
    present = {info.key.removeprefix(folder) for info in bucket.list(folder)}
    metrics_prefix = Model.of(config, bucket, prefix).metrics_prefix
    metrics_folder = keys.folder(metrics_prefix)
    metrics = {}
    for info in bucket.list(metrics_folder):
        found = _METRICS.fullmatch(info.key.removeprefix(metrics_folder))
        if found is not None:
            metrics[found[1]] = info.key
    stamps = sorted(metrics, reverse=True)

    def read(stamp: str) -> ListedEvaluation:
        recording = None
        if f"evaluation-{stamp}/recording.json" in present:
            recording = _recording(bucket, keys.evaluation_trace(prefix, stamp))
        return _listed(bucket, stamp, metrics[stamp], recording, present)

    videos = sorted(name for name in present if is_video(name))
    found_evaluations = at_once(read, stamps[:MOST_EVALUATIONS])
    return EvaluationList(f"s3://{bucket.name}/{prefix}", found_evaluations, len(stamps), videos)


def _listed(
    bucket: Bucket, stamp: str, key: str, recording: RaceRecording | None, present: set[str]
) -> ListedEvaluation:
    trials: list[TrialReport] = []
    problem = ""
    try:
        trials = trial_reports(read_record(bucket, key, _decode, remedy_of(key)))
    except (ObjectMissing, ObjectDamaged, ObjectNewer) as error:
        problem = f"{error} {error.remedy}"
    laps, clean = [trial.lap_s for trial in trials if trial.finished], laps_of(trials)
    return ListedEvaluation(
        stamp=stamp,
        world=recording.world if recording is not None else "",
        race_type=recording.race_type if recording is not None else "",
        reverse=recording.reverse if recording is not None else None,
        checkpoint=recording.checkpoint if recording is not None else "",
        trials=trials,
        complete_laps=len(laps),
        best_lap_s=clean.fastest_s,
        mean_lap_s=sum(laps) / len(laps) if laps else None,
        off_track_penalty_s=recording.off_track_penalty_s if recording is not None else None,
        collision_penalty_s=recording.collision_penalty_s if recording is not None else None,
        video=f"evaluation-{stamp}/video.mp4" in present,
        trace=f"evaluation-{stamp}/evaluation-simtrace/0-iteration.csv" in present,
        problem=problem,
        clean_laps=clean.clean,
        resets=sum(trial.resets for trial in trials),
        best_finished_s=best_finished_s(trials),
        summary=summary(trials),
    )


def _recording(bucket: Bucket, trace: str) -> RaceRecording | None:
    key = keys.recording_of(trace)
    try:
        return read_record(bucket, key, RaceRecording.decode, remedy_of(key))
    except (ObjectMissing, ObjectDamaged, ObjectNewer):
        return None


def _decode(data: bytes) -> list[TrialMetrics]:
    file = parse_json(data)
    if not isinstance(file, dict) or not isinstance(file.get("metrics"), list):
        raise RecordError("it has no list of 'metrics'")
    return [TrialMetrics.from_json(record) for record in file["metrics"]]
