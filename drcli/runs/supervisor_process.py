"""The supervisor as a process of its own, started by `drcli.runs.training.launch`."""

import sys

from drcli.base.errors import DrError
from drcli.exchange.job import Job
from drcli.runs.training import supervise_job

if __name__ == "__main__":
    try:
        raise SystemExit(supervise_job(Job.received()))
    except DrError as error:  # the launcher says it to the user; the log keeps it
        print(f"{error} {error.remedy}", file=sys.stderr)
        raise SystemExit(error.code) from None
