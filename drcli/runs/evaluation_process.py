"""What waits for an evaluation in the background, started by `launch_evaluation`."""

import sys

from drcli.base.errors import DrError
from drcli.base.log import LogFile, get_logger
from drcli.exchange.job import Job
from drcli.runs.evaluation import wait_in_background
from drcli.runs.run_logs import log_file

if __name__ == "__main__":
    job = Job.received()
    try:
        wait_in_background(job, sys.argv[1], sys.argv[2:])
    except DrError as error:  # the log was the worker's own until now
        path = log_file(job.settings, job.directory, "evaluation")
        LogFile(path, job.settings.log_max_mb << 20)
        get_logger(__name__).error("%s %s", error, error.remedy)
        raise SystemExit(error.code) from None
