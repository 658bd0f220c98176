"""Drives a race's queue, each run as `dr-evaluate` does."""

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from drcli.base.errors import DrError, NotAvailable, OwnershipLost, SettingsError, StorageError
from drcli.base.installation import lazy_imports
from drcli.base.processes import Stopped, until_sigterm
from drcli.bucket.bucket import Bucket
from drcli.config.settings import Settings
from drcli.model import race_keys
from drcli.model.model_store import ModelStore
from drcli.races import race_words as words
from drcli.races.lap_ranking import figures_of
from drcli.races.organise import show_race
from drcli.races.queue_lease import QueueLease, held, runner_of
from drcli.races.race_records import BracketDraw, DrivenCar, DrivenLap, RaceResult
from drcli.races.race_report import RaceReport
from drcli.races.race_settings import check_track, settings_of_rules, settings_of_run
from drcli.races.standings import Runner, counted, queue_of
from drcli.races.stored_race import StoredRace, put, read_race, read_rules, submission_id
from drcli.races.submissions import video_names
from drcli.run.evaluation import run_evaluation
from drcli.run.evaluation_plan import EvaluationPlan, prepare_evaluation
from drcli.run.evaluation_report import EvaluationReport, TrialReport
from drcli.view.video.encode import require_encoder

with lazy_imports():
    from drcli.view.video import make_video, trace_source, video_job

# Films a race as `dr-evaluate --video` does, in one view.


def film_car(
    plan: EvaluationPlan, bucket: Bucket, report: EvaluationReport, key: str
) -> tuple[str, list[str]]:
    """Film a car; returns the key (or "") and notes, also on failures."""
    try:
        with tempfile.TemporaryDirectory(prefix="drcli-race-") as temporary:
            path = Path(temporary) / "race.mp4"
            notes = _film(plan, bucket, report, path)
            bucket.put(key, path.read_bytes())
    except (DrError, OSError) as error:
        remedy = getattr(error, "remedy", "")
        return "", [f"{report.prefix} has no video: {error} {remedy}".strip()]
    return key, notes


def _film(plan: EvaluationPlan, bucket: Bucket, report: EvaluationReport, path: Path) -> list[str]:
    # Here, because a queue without videos must not load what draws.

    config = plan.job.config
    origin = f"evaluation {plan.stamp}"
    trace = trace_source.trace_of_key(
        ModelStore(bucket, report.prefix), report.simtrace, origin, ""
    )
    options = make_video.VideoOptions(
        episode="all", size=config.evaluation.eval_video_size, racer="", color=""
    )
    defaults = video_job.Defaults.of(config.model, config.race())
    return video_job.make_video(defaults, lambda: bucket, trace, options, [("film", path)]).notes


Say = Callable[[str], None]


def race_conditions(settings: Settings, bucket: Bucket, race: str) -> Settings:
    """Raises SettingsError without such a race, or for rules of other versions."""
    return settings_of_rules(settings, read_rules(bucket, race))


def check_queue(settings: Settings, bucket: Bucket, race: str) -> None:
    """Refuse what would fail for every run.

    Raises:
        SettingsError: Race or track is missing, or another process drives the queue.
    """
    check_track(race_conditions(settings, bucket, race))
    runner = runner_of(bucket, race)
    if runner.session:
        raise SettingsError(
            f"The queue of race {race} is being driven by {runner.owner}.",
            remedy=f"Watch it with `dr-race show {race}`, or stop it there with `dr-race stop "
            f"{race}`.",
        )


def run_queue(
    settings: Settings,
    bucket: Bucket,
    race: str,
    *,
    video: bool | None = None,
    limit: int = 0,
    on_progress: Say = lambda text: None,
) -> RaceReport:
    """Drive everything in the queue, and what is submitted meanwhile.

    Killed runs are driven again, failed ones only after `restart`. A `limit` of 0 is none; `video`
    of None films if it can.

    Raises:
        SettingsError: As for `check_queue`.
        NotAvailable: A wanted video has no encoder.
        StorageError: The bucket does not answer; what was driven is kept.
        OwnershipLost: Another process took the queue.
        Stopped: SIGTERM came.
    """
    check_queue(settings, bucket, race)
    missing = _no_video(video)
    films = video is not False and not missing
    if missing:
        on_progress(missing)
    stopped = until_sigterm(
        "The queue of the race was stopped; what was driven is kept.",
        f"Drive the rest with `dr-race run {race}`.",
    )
    driven = 0
    with stopped, held(bucket, race) as lease:
        while not limit or driven < limit:
            stored = read_race(bucket, race)
            runs = queue_of(stored, Runner(lease.session))
            if not runs:
                break
            if stored.rules.in_pairs and stored.rules.pairing == "bracket" and stored.draw is None:
                lease.check()
                put(bucket, race_keys.draw(race), BracketDraw(counted(stored)))
                on_progress(f"The bracket of {len(counted(stored))} submissions is drawn.")
                continue
            if len(runs) > 1:
                on_progress(f"{len(runs)} runs wait.")
            _drive(settings, bucket, lease, stored, runs[0], films, missing, on_progress)
            driven += 1
    return show_race(bucket, race)


def _no_video(video: bool | None) -> str:
    if video is False:
        return ""

    try:
        require_encoder()
    except NotAvailable as error:
        if video:
            raise
        return f"There are no videos of this race. {error} {error.remedy}"
    return ""


def _drive(
    settings: Settings,
    bucket: Bucket,
    lease: QueueLease,
    stored: StoredRace,
    run: tuple[str, ...],
    films: bool,
    note: str,
    on_progress: Say,
) -> None:
    race, name = stored.race, "_".join(sorted(run))
    who = " against ".join(
        f"{stored.submissions[each].racer} ({submission_id(each)})" for each in run
    )
    lease.check()
    begun = RaceResult("running", lease.session, stored.restarts(*run), time.time())
    key = race_keys.result(race, name)
    put(bucket, key, begun)
    most = stored.rules.max_laps
    laps = f"{most} lap{'s' * (most > 1)} on {stored.rules.world}"
    on_progress(f"Driving {who}: {laps}, whose times follow when all are driven ...")
    try:
        result = _evaluated(settings, bucket, stored, run, films, begun, on_progress)
        if note:
            result = replace(result, notes=[*result.notes, note])
    except (StorageError, OwnershipLost, Stopped):
        raise
    except DrError as error:
        result = replace(
            begun, state="failed", message=str(error), remedy=error.remedy, ended_at=time.time()
        )
    lease.check()
    gone = [each for each in run if not bucket.exists(race_keys.submission(race, each))]
    if gone:
        left = [info.key for each in gone for info in bucket.list(race_keys.models(race, each))]
        bucket.delete([key, *left, *(car.video for car in result.cars if car.video)])
        on_progress(f"{who}: withdrawn meanwhile.")
        return
    put(bucket, key, result)
    on_progress(f"{who}: {_outcome(result)}")


def _evaluated(
    settings: Settings,
    bucket: Bucket,
    stored: StoredRace,
    run: tuple[str, ...],
    films: bool,
    begun: RaceResult,
    on_progress: Say,
) -> RaceResult:
    conditions = settings_of_rules(settings, stored.rules)
    own = settings_of_run(conditions, stored, run)
    plan = prepare_evaluation(own, seed=stored.rules.seed)
    report = run_evaluation(plan, on_progress)
    reports = [report, *([report.opponent] if report.opponent is not None else [])]
    notes = list(report.notes)
    videos = ["" for _ in reports]
    if films:
        on_progress("Filming the laps ...")
        for number, name in enumerate(video_names("_".join(sorted(run)))):
            key = race_keys.video(stored.race, name)
            videos[number], more = film_car(plan, bucket, reports[number], key)
            notes += [note for note in more if note not in notes]
    cars = [
        DrivenCar(
            submission=name,
            laps=[lap_driven(trial) for trial in each.trials],
            simtrace=each.simtrace,
            metrics=each.metrics,
            video=video,
        )
        for name, each, video in zip(run, reports, videos, strict=True)
    ]
    return replace(begun, state="done", cars=cars, notes=notes, ended_at=time.time())


def _outcome(result: RaceResult) -> str:
    if result.state == "failed":
        return f"failed. {result.message}"
    texts = []
    for car in result.cars:
        figures = figures_of(car.laps, 1)
        best = f", best {words.time_of(figures.best)}" if figures.best else ""
        texts.append(f"{words.laps_of(figures)}{best}")
    return "; ".join(texts) + "."


def lap_driven(trial: TrialReport) -> DrivenLap:
    return DrivenLap(
        trial.lap_s,
        trial.progress,
        trial.status,
        trial.off_track,
        trial.crashes,
        trial.resets,
        trial.penalty_s,
        trial.immobilized,
        trial.reversed,
    )
