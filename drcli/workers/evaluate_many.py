"""A worker that drives a share of many evaluations, one after another.

`python -m drcli.workers.evaluate_many SHARE SHARES`: each SHARES-th task from SHARE on. Files
in the job's folder say what came of them.
"""

import sys
from dataclasses import replace

from drcli.base.atomic_file import save_record
from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.config.run_config import RunConfig
from drcli.exchange.evaluation_task import EvaluationTask, TaskOutcome
from drcli.exchange.job import Job
from drcli.store import keys
from drcli.store.connect import open_bucket
from drcli.workers import worker_process
from drcli.workers.cores import usable_cores
from drcli.workers.evaluator import Entry, evaluate
from drcli.workers.live_scene import facts_of
from drcli.workers.live_view import LiveShow, live_show
from drcli.workers.reward_failures import reward_failure
from drcli.workers.robust_drive import evaluate_robustly
from drcli.workers.worker_process import Lifeline
from drsim.errors import RewardError

_logger = get_logger(__name__)


def drive_share(
    job: Job, lifeline: Lifeline, share: int, shares: int, live: LiveShow | None = None
) -> None:
    threads = max(1, usable_cores(job.config.train) // shares)
    for task in job.tasks[share::shares]:
        _logger.info("Evaluates %s of %s on %s.", task.checkpoint, task.prefix, task.world)
        try:
            outcome = _driven(job, lifeline, task, threads, live)
        except RewardError as error:
            outcome = _refused(reward_failure(error))
        except DrError as error:
            outcome = _refused(error)
        save_record(job.folder / task.outcome_file, outcome)


def config_of(config: RunConfig, task: EvaluationTask) -> RunConfig:
    race = config.race().replaced(world_name=task.world)
    model = replace(config.model, prefix=task.prefix, metrics_prefix=task.metrics_prefix)
    return replace(config, model=model, races=(race,))


def _driven(
    job: Job, lifeline: Lifeline, task: EvaluationTask, threads: int, live: LiveShow | None
) -> TaskOutcome:
    config = config_of(job.config, task)
    entry = Entry(
        task.prefix,
        task.checkpoint,
        keys.evaluation_trace(task.prefix, task.stamp),
        keys.evaluation_metrics(task.metrics_prefix, task.stamp),
        task.source,
    )
    if task.robust:
        bucket = open_bucket(config.storage, hurried=lifeline.should_stop)
        robust = evaluate_robustly(
            job, lifeline, bucket, entry, config, stamp=task.stamp, threads=threads, live=live
        )
        return TaskOutcome(robust=robust)
    found = evaluate(
        job,
        lifeline,
        [entry],
        config=config,
        threads=threads,
        live=live,
        fresh_laps=task.fresh_laps,
    )
    return TaskOutcome(trials=found.racers[0], notes=found.notes)


def _refused(error: DrError) -> TaskOutcome:
    _logger.warning("%s %s", error, error.remedy)
    return TaskOutcome(reason=str(error), remedy=error.remedy, code=error.code)


def main(job: Job, lifeline: Lifeline) -> None:
    share, shares = map(int, sys.argv[1:])
    facts = facts_of(job.config.race(), [job.config.model.prefix])
    name = f"evaluation-{share}"
    with live_show(job, name, lambda: lifeline.pulse.activity, facts) as live:
        drive_share(job, lifeline, share, shares, live)


if __name__ == "__main__":
    worker_process.run("evaluation", main)
