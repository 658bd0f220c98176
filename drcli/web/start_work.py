"""Starts trainings for tasks of the page, in a process of its own."""

from typing import TYPE_CHECKING, Any

from drcli.base.errors import WorkerDied
from drcli.config.settings import Settings
from drcli.config.track_names import to_fetch
from drcli.runs.status import inspect
from drcli.web.tasks import Progress

if TYPE_CHECKING:
    from drcli.runs.plan import StartOptions


def tracks_to_fetch(settings: Settings) -> list[str]:
    """Community tracks that a start needs and that are not installed."""
    from drcli.checks.stage_rules import review_stages

    staged = review_stages(settings, {})
    run = settings.run
    races = [race for stage in staged.stages for race in stage.settings.races]
    second = run.second_race(run.race())
    return to_fetch([*(races or settings.races), *([second] if second is not None else ())])


def start_training(
    progress: Progress, settings: Settings, options: "StartOptions", fetches: bool
) -> dict[str, Any]:
    """Check everything and start a training in the background, as `dr-start-training -q` does.

    Args:
        progress: Shows what is done.
        settings: Of the training.
        options: How it starts.
        fetches: Whether community tracks that are missing may be fetched.

    Raises:
        DrError: It cannot start.
    """
    from drcli.runs import plan, training
    from drcli.tracks.community import fetch_track

    missing = tracks_to_fetch(settings) if fetches and settings.tracks_fetch != "never" else []
    for name in missing:
        progress(f"Fetching the track {name} ...")
        fetch_track(name, settings.tracks_url, settings.tracks_folder)
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
