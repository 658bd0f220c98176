"""Publishes what simulation workers elsewhere need to join; without secrets."""

import json
import time
from dataclasses import asdict, replace
from threading import Thread

from drcli.base.errors import DrError
from drcli.base.json_record import json_default
from drcli.base.log import get_logger
from drcli.config.run_config import FigureConfig
from drcli.exchange.job import Job
from drcli.exchange.joined_worker import JoinRecord
from drcli.runs.duty import Duty, RunningTraining
from drcli.runs.join_check import routes, versions
from drcli.store import keys
from drcli.workers.cores import with_known_overlap

_logger = get_logger(__name__)


LATER_S = 3.0
"""The training's own workers start meanwhile."""


class JoinOffer(Duty):
    name = "join offer"

    def start(self, run: RunningTraining) -> None:
        after_s = LATER_S if run.job.config.train.workers else 0.0
        Thread(target=self._write, args=(run, after_s), name="join-offer", daemon=True).start()

    def _write(self, run: RunningTraining, after_s: float) -> None:
        time.sleep(after_s)
        try:
            key = keys.join_record(run.job.config.model.prefix)
            run.open_bucket().put(key, offer(run.job).encode())
        except (DrError, OSError) as error:
            _logger.warning("No worker can join this training: %s", error)


def offer(job: Job) -> JoinRecord:
    public = job.without_addresses()
    figures = FigureConfig(**{each.field: each.default for each in FigureConfig.declared.values()})
    train = with_known_overlap(job.config.train)
    config = replace(public.config, train=train, figures=figures, given={})
    job_json = json.dumps(asdict(replace(public, config=config)), default=json_default)
    return JoinRecord(job.session, versions(), routes(job), json.loads(job_json))
