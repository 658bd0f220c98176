"""The supervisor as a process of its own, started by `drcli.runs.training.launch`."""

from drcli.base import notices
from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.exchange.job import Job
from drcli.runs.training import supervise_job

if __name__ == "__main__":
    logger = get_logger(__name__)
    notices.show, notices.warn = logger.info, logger.warning
    try:
        raise SystemExit(supervise_job(Job.received()))
    except DrError as error:  # it is in the log, and the launcher shows it to the user
        raise SystemExit(error.code) from None
