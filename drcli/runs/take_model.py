"""Takes a model: of several starts at the same time, one trains."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from drcli.base.errors import StorageError
from drcli.base.file_lock import only_writer
from drcli.checks.start_rules import refuse_second_run
from drcli.exchange.job import Job
from drcli.store import lease
from drcli.store.bucket import Bucket


@contextmanager
def taken(job: Job, bucket: Bucket, review: Callable[[], None]) -> Iterator[None]:
    """Take the lease of the model prefix; released if the `with` block fails.

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
