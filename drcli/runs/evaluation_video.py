"""Films an evaluation when it has ended (DR_EVAL_SAVE_MP4)."""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.runs.evaluation_plan import EvaluationPlan
from drcli.runs.evaluation_report import EvaluationReport
from drcli.store.connect import open_bucket

if TYPE_CHECKING:
    from drcli.store.bucket import Bucket
    from drcli.video.film import View

_logger = get_logger(__name__)


def filmed(
    plan: EvaluationPlan, report: EvaluationReport, on_progress: Callable[[str], None]
) -> EvaluationReport:
    """A failure is a note: the laps were driven."""
    config = plan.job.config
    if not config.evaluation.eval_save_mp4:
        return report
    bucket = open_bucket(config.storage)
    report = _with_videos(
        plan, bucket, report, config.model.prefix, plan.simtrace, plan.stamp, on_progress
    )
    if report.opponent is None:
        return report
    folder = config.evaluation.eval_opp_model_prefix
    other = _with_videos(
        plan, bucket, report.opponent, folder, report.opponent.simtrace, "", on_progress
    )
    return replace(report, opponent=other, notes=[*report.notes, *other.notes])


def _with_videos(
    plan: EvaluationPlan,
    bucket: "Bucket",
    report: EvaluationReport,
    folder: str,
    simtrace: str,
    stamp: str,
    on_progress: Callable[[str], None],
) -> EvaluationReport:
    # Here, because a supervisor of a training must not load what draws.
    from drcli.video.make_video import Wish, frames_of
    from drcli.video.trace_source import trace_of_key
    from drcli.video.video_job import CAMERAS, Defaults, make_video, put_videos

    config = plan.job.config
    try:
        with tempfile.TemporaryDirectory(prefix="drcli-video-") as temporary:
            files: dict[View, Path] = {
                view: Path(temporary) / f"{camera}.mp4" for view, camera in CAMERAS.items()
            }
            trace = trace_of_key(bucket, report.prefix, simtrace, f"evaluation {plan.stamp}", "")
            wish = Wish(episode="all", size=config.evaluation.eval_video_size, racer="", color="")
            on_progress(f"Filming {frames_of(trace, wish)} frames for {len(files)} videos ...")
            found = make_video(
                Defaults.of(config.model, config.race()),
                lambda: bucket,
                trace,
                wish,
                list(files.items()),
            )
            put = put_videos(bucket, folder, stamp, files)
    except (DrError, OSError) as error:
        remedy = getattr(error, "remedy", "")
        note = f"The evaluation has no video: {error} {remedy}".strip()
        _logger.warning("%s", note)
        return replace(report, notes=[*report.notes, note])
    notes = [note for note in found.notes if note not in report.notes]
    return replace(report, videos=put, notes=[*report.notes, *notes])
