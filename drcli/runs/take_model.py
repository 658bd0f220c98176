"""Takes a model for a start: of several starts at the same time, one trains."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from drcli.base.errors import StorageError
from drcli.base.file_lock import only_writer
from drcli.exchange.job import Job
from drcli.exchange.run_record import RunRecord
from drcli.store import lease
from drcli.store.bucket import Bucket


def refuse_second_run(run_id: int, folder: Path) -> None:
    """Return if no training of this run number is alive on this machine.

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


@contextmanager
def taken(job: Job, bucket: Bucket, review: Callable[[], None]) -> Iterator[None]:
    """Take the lease of the model prefix, and release it if the `with` block fails.

    Another start may have taken it during the checks, which need seconds. The folder is locked only
    for this step, because other commands need it too.

    Raises:
        SettingsError: Another start was faster.
    """
    prefix = job.config.model.prefix
    with only_writer(job.directory):
        refuse_second_run(job.config.run_id, job.folder)
        lease.refuse_other_owner(bucket, prefix, job.session)
        review()
        lease.take(bucket, prefix, job.session)
    try:
        yield
    except BaseException:
        with suppress(StorageError):
            lease.release(bucket, prefix, job.session)
        raise
