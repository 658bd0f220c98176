"""What refuses a start before files and bucket are read."""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import BudgetUsedUp, DrError, SettingsError
from drcli.base.problems import Problem, ProblemsError
from drcli.config.settings import Settings
from drcli.exchange.daily_spending import budget_of
from drcli.exchange.run_record import RunRecord, run_folder
from drcli.store import lease
from drcli.tracking.open_sinks import check_figures
from drcli.workers.ray_extra import has_cluster, require_ray


@dataclass(frozen=True)
class StartRule:
    """One thing that must hold; its check raises DrError.

    Attributes:
        key: The setting of its problem; empty if the check names the place.
        of_machine: Not for one that trains elsewhere.
    """

    rule: str
    key: str
    check: Callable[[Settings], None]
    of_machine: bool = True


def refuse_second_run(run_id: int, folder: Path) -> None:
    """Return if no training of this number is alive here.

    Raises:
        ModelInUse: One is.
    """
    record = RunRecord.read(folder)
    if record is not None and record.alive:
        raise lease.ModelInUse(
            f"Run {run_id} is training s3://{record.bucket}/{record.prefix} already "
            f"(process {record.pid}).",
            remedy="Stop it with `dr-stop-training`, or give this one another DR_RUN_ID and "
            "another DR_LOCAL_S3_MODEL_PREFIX.",
        )


def _trainable(settings: Settings) -> None:
    if settings.untrainable is not None and not settings.curriculum_file:
        raise ProblemsError([settings.untrainable])


def _free_run(settings: Settings) -> None:
    refuse_second_run(settings.run_id, run_folder(settings.directory, settings.run_id))


def _within_budget(settings: Settings) -> None:
    budget = budget_of(settings.directory, settings.run.unattended, time.time())
    if budget.used_up is not None:
        raise BudgetUsedUp(budget.used_up, remedy=budget.remedy)


def _on_ray(settings: Settings) -> None:
    if settings.launcher == "ray":
        require_ray()


def _in_cluster(settings: Settings) -> None:
    wanted = settings.ray_trainer
    if settings.launcher == "ray" and wanted in ("cluster", "gpu") and not has_cluster(settings):
        raise SettingsError(
            f"DR_RAY_TRAINER={wanted} in system.env: there is no cluster for the trainer, because "
            "Ray starts on this machine alone.",
            remedy="Write its address into DR_RAY_ADDRESS, or set DR_RAY_TRAINER=auto.",
        )


def _writes_logs(settings: Settings) -> None:
    folder = settings.directory / "data" / "logs"
    place = next(place for place in (folder, *folder.parents) if place.exists())
    if not (place.is_dir() and os.access(place, os.W_OK | os.X_OK)):
        what = f"{place}: logs cannot be written there."
        remedy = f"Check that you can write to {folder}, or move it."
        raise ProblemsError([Problem("V-50", "error", str(place), None, what, remedy)])


RULES = (
    StartRule("V-07", "DR_RACE_TYPE", _trainable, of_machine=False),
    StartRule("V-13", "DR_RUN_ID", _free_run),
    StartRule("V-12", "DR_DAILY_BUDGET_HOURS", _within_budget),
    StartRule("V-12", "DR_TENSORBOARD", lambda settings: check_figures(settings.run.figures)),
    StartRule("V-12", "DR_LAUNCHER", _on_ray),
    StartRule("V-12", "DR_RAY_TRAINER", _in_cluster),
    StartRule("V-50", "", _writes_logs),
)


def refuse_start(settings: Settings) -> None:
    """Raise the DrError of the first rule that does not hold."""
    for each in RULES:
        each.check(settings)


def start_problems(settings: Settings, *, here: bool) -> Iterator[Problem]:
    """Without `here`, of the rules for any machine."""
    for each in RULES:
        if each.of_machine and not here:
            continue
        try:
            each.check(settings)
        except ProblemsError as error:
            yield from error.problems
        except DrError as error:
            place = settings.place(each.key)
            yield Problem(each.rule, "error", *place, str(error), error.remedy, each.key)
