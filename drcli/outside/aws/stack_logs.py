"""Logs of a stack's machines: of trainings and boots in the bucket."""

from drcli.base.errors import Absent
from drcli.bucket.bucket import ObjectInfo
from drcli.model import keys
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.machine_marks import log_folder
from drcli.outside.aws.stacks import Stack


def list_logs(account: Account, stack: Stack, part: str = "") -> list[ObjectInfo]:
    """Logs with `part` in their name, those of the training first.

    Raises:
        Absent: There is none.
        StorageError: The bucket cannot be read.
    """
    bucket = account.bucket(stack.bucket)
    folders = (f"{keys.folder(stack.model)}logs/", log_folder(stack.name))
    every = [info for folder in folders for info in bucket.list(folder)]
    chosen = [info for info in every if part in info.key.rpartition("/")[2]]
    if not chosen:
        raise Absent(
            f"{stack.name} has no log{f' {part}' if part else ''} in the bucket yet.",
            remedy="A machine writes its first log a few minutes after its start; `dr-spot list` "
            "shows how it is.",
        )
    return chosen


def read_log(account: Account, stack: Stack, key: str, lines: int) -> list[str]:
    """The last lines of a log, without their ends."""
    text = account.bucket(stack.bucket).get(key).decode(errors="replace")
    return text.splitlines()[-lines:]
