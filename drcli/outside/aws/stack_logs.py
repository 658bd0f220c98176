"""What is seen of a stack's training from here: logs, and the folder of its machine."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from drcli.base.errors import Absent, StorageError
from drcli.base.files import find_files, make_folder, write_private
from drcli.base.installation import lazy_imports
from drcli.base.json_record import decode_json
from drcli.bucket.bucket import ObjectInfo, ObjectMissing
from drcli.bucket.s3_errors import error_code
from drcli.config import secret_environment
from drcli.model import keys
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.machine_marks import file_key, install_key, log_folder
from drcli.outside.aws.machines import Machine
from drcli.outside.aws.stacks import Stack

with lazy_imports():
    from botocore import exceptions as boto


_OF_PROGRAMS = ("AWS_", "LD_", "DYLD_", "PYTHON")
"""Variables that decide what programs load, and whose keys they use."""


@dataclass(frozen=True)
class _Install:
    """What the boot script reads first."""

    files: list[str] = field(default_factory=list)
    environment: dict[str, str] = field(default_factory=dict)


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
    if every and not chosen:
        names = sorted({info.key.rpartition("/")[2] for info in every})
        raise Absent(
            f"{stack.name} has no log with '{part}' in its name in the bucket.",
            remedy=f"There are {', '.join(names)}.",
        )
    if not chosen:
        raise Absent(
            f"{stack.name} has no log in the bucket yet.",
            remedy="A machine writes its first log a few minutes after its start; `dr-spot list` "
            f"shows how it is, `dr-spot logs {stack.name} console` what it has printed.",
        )
    return chosen


def read_log(account: Account, stack: Stack, key: str, lines: int) -> list[str]:
    """The last lines of a log, without their ends."""
    text = account.bucket(stack.bucket).get(key).decode(errors="replace")
    return text.splitlines()[-lines:]


def read_console(account: Account, machine: Machine, lines: int) -> list[str]:
    """The last lines that a machine has printed, which Amazon keeps for an hour after its end.

    Raises:
        Absent: Amazon does not know the machine any more, or has nothing yet.
        StorageError: Amazon does not answer or refuses.
    """
    asked: dict[str, Any] = {"InstanceId": machine.instance, "Latest": True}
    text = ""
    unknown = "InvalidInstanceID.NotFound"
    with account.trying("read what the machine has printed", unless=(unknown,)):
        try:
            answer = account.client("ec2").get_console_output(**asked)
        except boto.ClientError as error:
            if error_code(error) != "UnsupportedOperation":
                raise
            # Older types of machines: what they had printed a few minutes ago.
            del asked["Latest"]
            answer = account.client("ec2").get_console_output(**asked)
        text = answer.get("Output") or ""
    if not text.strip():
        raise Absent(
            f"Amazon has nothing that {machine.instance} has printed.",
            remedy="It comes a minute after the start of a machine, and goes an hour after its "
            "end.",
        )
    return text.splitlines()[-lines:]


def fetch_folder(
    account: Account, stack: Stack, folder: Path, environ: Mapping[str, str]
) -> dict[str, str]:
    """Write the files of the machine into a folder, to read its training from here.

    Returns:
        The environment that its settings are to be read with: of `environ` all but other
        settings, and the bucket of the stack.
    """
    bucket = account.bucket(stack.bucket)
    key, install = install_key(stack.name), _Install()
    try:
        install = decode_json(_Install, bucket.get(key))
        if outside := [name for name in install.files if not _is_below(name)]:
            raise ValueError(f"it names the file {outside[0]}")
        files = {name: bucket.get(file_key(stack.name, name)) for name in install.files}
    except ObjectMissing:
        files = {}
    except ValueError as error:
        raise StorageError(
            f"s3://{bucket.name}/{key} is not what `dr-spot create` writes: {error}.",
            remedy=f"Remove the stack with `dr-spot delete {stack.name}`, and create it again.",
        ) from error
    for old in find_files(folder, "*.env"):
        old.unlink()
    for name, data in {"run.env": b"", **files}.items():
        make_folder((folder / name).parent)
        write_private(folder / name, data)
    kept = {
        name: value
        for name, value in environ.items()
        if not name.startswith("DR_") or secret_environment.is_secret(name, value)
    }
    # Whoever may write to the bucket must not decide what programs here load.
    given = {
        name: value
        for name, value in install.environment.items()
        if name.startswith("DR_") or not (name in environ or name.startswith(_OF_PROGRAMS))
    }
    return {
        **kept,
        **given,
        "DR_CLOUD": "aws",
        "DR_AWS_APP_REGION": account.region,
        "DR_LOCAL_S3_BUCKET": stack.bucket,
        "DR_LOCAL_S3_MODEL_PREFIX": stack.model,
        "DR_LOCAL_S3_PROFILE": account.profile or "default",
        "DR_UPLOAD_S3_PROFILE": account.profile or "default",
    }


def _is_below(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts
