"""Films a race as `dr-evaluate --video` does, in one view."""

import tempfile
from pathlib import Path

from drcli.base.errors import DrError
from drcli.runs.evaluation_plan import EvaluationPlan
from drcli.runs.evaluation_report import EvaluationReport
from drcli.store.bucket import Bucket


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
    from drcli.video.make_video import Wish
    from drcli.video.trace_source import trace_of_key
    from drcli.video.video_job import Defaults, make_video

    config = plan.job.config
    origin = f"evaluation {plan.stamp}"
    trace = trace_of_key(bucket, report.prefix, report.simtrace, origin, "")
    wish = Wish(episode="all", size=config.evaluation.eval_video_size, racer="", color="")
    defaults = Defaults.of(config.model, config.race())
    return make_video(defaults, lambda: bucket, trace, wish, [("film", path)]).notes
