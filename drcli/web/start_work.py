"""Starts trainings in a process of its own."""

from typing import TYPE_CHECKING, Any

from drcli.base.errors import WorkerDied
from drcli.config.settings import Settings
from drcli.runs.status import inspect
from drcli.web.tasks import Progress

if TYPE_CHECKING:
    from drcli.runs.plan import StartOptions


def start_training(
    progress: Progress, settings: Settings, options: "StartOptions", fetches: bool
) -> dict[str, Any]:
    """As `dr-start-training -q`; `fetches` missing community tracks."""
    from drcli.runs import plan, training
    from drcli.runs.track_fetch import fetch, missing_tracks

    missing = missing_tracks(settings) if fetches else []
    for name in missing:
        progress(f"Fetching the track {name} ...")
        fetch(settings, name)
    progress("Checking settings, files and reward function ...")
    planned = plan.prepare(settings, options)
    progress("Starting the workers ...")
    pid = training.launch(planned)
    if inspect(settings.run).pid != pid:
        raise WorkerDied(
            "The training did not start.", remedy="Read the reason with `dr-logs supervisor`."
        )
    return {
        "model": settings.model_prefix,
        "bucket": settings.bucket,
        "pid": pid,
        "warnings": planned.warnings,
        "resumes": planned.resumes,
        "ends": planned.ends,
    }
