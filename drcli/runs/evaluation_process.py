"""What waits for an evaluation in the background, started by `launch_evaluation`."""

import sys

from drcli.base.errors import DrError
from drcli.exchange.job import Job
from drcli.runs.evaluation import wait_in_background

if __name__ == "__main__":
    try:
        wait_in_background(Job.received(), sys.argv[1], sys.argv[2:])
    except DrError as error:
        print(f"evaluation: {error} {error.remedy}")
        raise SystemExit(error.code) from None
