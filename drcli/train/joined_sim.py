"""A worker that joins a training: `python -m drcli.train.joined_sim MEMBER`.

`dr-start-worker` runs it; MEMBER is its unique name.
"""

import sys

from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.learn.compute import flush_denormals
from drcli.live.live_view import live_show
from drcli.model.model_store import ModelStore
from drcli.records.job import Job
from drcli.train.membership import Membership
from drcli.train.sim import SimWorker
from drcli.workers import worker_process
from drcli.workers.reward_failures import reward_failure
from drcli.workers.worker_process import StopSignal
from drsim.errors import RewardError

_logger = get_logger(__name__)


def main(job: Job, stop_signal: StopSignal) -> None:
    flush_denormals()
    member, prefix = sys.argv[1], job.config.model.prefix
    bucket = worker_process.open_own_bucket(job, stop_signal, far=True)
    membership = Membership(ModelStore(bucket, prefix), job.session, member, stop_signal)
    try:
        number = membership.wait_for_number()
        _logger.info("This is simulation worker %d of s3://%s/%s.", number, bucket.name, prefix)
        with live_show(job, f"sim-{number}", stop_signal.heartbeat, [prefix], number) as live:
            SimWorker(job, stop_signal, number, live=live, membership=membership).run()
    except RewardError as error:
        membership.close(str(reward_failure(error)))
        raise
    except DrError as error:
        membership.close(str(error))
        raise
    finally:
        membership.close()
        if stop_signal.ended:
            _logger.info("The training has stopped: %s.", stop_signal.ended)


if __name__ == "__main__":
    worker_process.run(sys.argv[1], main)
