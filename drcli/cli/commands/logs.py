"""`dr logs`."""

import re
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.clock import moment
from drcli.base.errors import Absent, SettingsError, StorageError
from drcli.base.installation import lazy_imports
from drcli.cli import completion, terminal
from drcli.cli.log_tail import POLL_S, chosen, show_log
from drcli.cli.options import text_only
from drcli.cli.working_folder import settings, working_folder
from drcli.model.model_store import ModelStore

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.run.read_logs import UploadedLog

with lazy_imports():
    from drcli.bucket import connect
    from drcli.records import run_record
    from drcli.run import read_logs


# Shows the uploaded copy of a log.


UPLOAD_POLL_S = 20.0
"""Logs are uploaded every five minutes."""


def show_uploaded_log(log: "UploadedLog", last_lines: int | None, since: datetime | None) -> bytes:
    """Print a log or its end, and return that."""
    if last_lines is not None and since is None:
        text = log.last_lines(last_lines)
        terminal.write(text.decode("utf-8", "replace"))
        return text
    end = b""

    def read() -> Iterator[str]:
        nonlocal end
        for piece in log.pieces(since):
            end = piece
            yield piece.decode("utf-8", "replace")

    for piece in chosen(read(), last_lines, since):
        terminal.write(piece)
    return end


def follow_uploaded_log(log: "UploadedLog", shown: bytes, until: Callable[[], bool]) -> None:
    tail = read_logs.UploadedTail(log.bucket, log.key, shown)
    failure = ""
    while not until():
        try:
            text = tail.read()
            failure = ""
        except StorageError as error:  # it may answer again
            text = b""
            if str(error) != failure:
                failure = str(error)
                terminal.warn(failure)
        terminal.write(text.decode("utf-8", "replace"), followed=True)
        next_look = time.monotonic() + UPLOAD_POLL_S
        while time.monotonic() < next_look and not until():
            time.sleep(POLL_S)


TAIL_LINES = 20


@text_only
def logs(
    worker: Annotated[
        str,
        typer.Argument(
            metavar="WHO",
            help="sim, trainer, supervisor, evaluation or reward.",
            autocompletion=completion.workers,
        ),
    ] = "sim",
    number: Annotated[
        int,
        typer.Option(
            "-n",
            "--number",
            metavar="N",
            help="Number of the sim worker, from 0, for sim and reward.",
            min=0,
        ),
    ] = 0,
    lines: Annotated[
        int | None,
        typer.Option(
            "-l",
            "--lines",
            metavar="N",
            min=0,
            help=f"Begin with the last N lines; {TAIL_LINES} unless --since is given.",
        ),
    ] = None,
    since: Annotated[
        str | None,
        typer.Option(
            "--since",
            metavar="WHEN",
            help="Begin at a time (UTC) such as 2026-11-22T09:30, or an age such as 30m or 2h.",
        ),
    ] = None,
    follow: Annotated[
        bool, typer.Option("-f", "--follow", help="Follow the log until Ctrl-C.")
    ] = False,
    whole: Annotated[
        bool, typer.Option("-a", "--all", help="Show the whole log instead of the last lines.")
    ] = False,
    json_lines: Annotated[
        bool,
        typer.Option("--json-lines", help="Show its JSON lines, one object for each record."),
    ] = False,
    uploaded: Annotated[
        bool,
        typer.Option("--uploaded", help="Read the copy in the bucket although there is a log."),
    ] = False,
) -> None:
    """Show a worker's log, or what the reward function prints.

    dr-logs reward shows only what the reward function prints in a simulation worker, and its
    failures; dr-logs reward-evaluation shows the same for evaluations. --json-lines needs
    DR_LOG_JSON=True at the start of the training. If the log is not on this machine, its copy in
    the bucket is read, which a training uploads every five minutes and at its end. Exits 1 when
    there is no log yet.

    Example: dr-logs reward -f
    """
    loaded, name = settings(), _name(worker, number)
    if whole and lines is not None:
        raise typer.BadParameter("--all and --lines exclude each other.")
    if json_lines and name.startswith("reward"):
        raise _no_json_lines(name)
    begin = _begin(since, name)
    count = lines if lines is not None or whole or begin is not None else TAIL_LINES
    path = run_record.log_file(working_folder(), loaded.model_prefix, name)
    path = run_record.json_log(path) if json_lines else path
    if not uploaded and path.exists():
        show_log(path, count, lambda: follow, since=begin)
        return
    copy = _copy(loaded, name, path.name, keep_waiting=follow and not uploaded)
    if copy is not None:
        try:
            _show_copy(copy, path, count, begin, follow=follow, uploaded=uploaded)
        except KeyboardInterrupt:
            return
        if not follow or uploaded:
            return
        count = None  # the log has appeared here: all of it is new
    elif not follow or uploaded:
        raise _absent(loaded, name, path, json_lines=json_lines, uploaded=uploaded)
    else:
        terminal.say(f"Waiting for {path} ...")
    show_log(path, count, lambda: follow)


def _show_copy(
    copy: "UploadedLog",
    path: Path,
    count: int | None,
    since: datetime | None,
    *,
    follow: bool,
    uploaded: bool,
) -> None:
    reason = "" if uploaded else f"{path} does not exist. "
    when = copy.uploaded.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S")
    terminal.say(f"{reason}Reading s3://{copy.bucket.name}/{copy.key}, uploaded {when} UTC.")
    shown = show_uploaded_log(copy, count, since)
    if follow:
        follow_uploaded_log(copy, shown, lambda: not uploaded and path.exists())


def _copy(loaded: "Settings", name: str, file: str, *, keep_waiting: bool) -> "UploadedLog | None":
    try:
        bucket = connect.open_running_bucket(loaded.storage)
        return (
            None
            if bucket is None
            else read_logs.find_uploaded(ModelStore(bucket, loaded.model_prefix), name, file)
        )
    except StorageError as error:
        if not keep_waiting:
            raise
        terminal.warn(f"The copy in the bucket could not be read: {error}")
        return None


def _begin(since: str | None, name: str) -> datetime | None:
    if since is None:
        return None
    if name.startswith("reward"):
        raise SettingsError(
            f"{name} has no times: it contains what the reward function prints, unchanged.",
            remedy="Leave out --since. With DR_LOG_JSON=True, "
            f"`dr-logs {_worker_of(name)} --json-lines --since {since}` has the prints, too.",
        )

    return moment("--since", since, datetime.now(UTC))


def _worker_of(name: str) -> str:
    worker = name.removeprefix("reward-")
    return f"sim-{worker}" if worker.isdecimal() else worker


def _no_json_lines(name: str) -> SettingsError:
    return SettingsError(
        f"{name} has no JSON lines of its own.",
        remedy="Those of the worker have its prints, with the event `print`: "
        f"`dr-logs {_worker_of(name)} --json-lines`.",
    )


def _absent(
    loaded: "Settings", name: str, path: Path, *, json_lines: bool, uploaded: bool
) -> Absent:
    remedy = _remedy(name, loaded.workers)
    if json_lines and not loaded.log_json:
        remedy = "Set DR_LOG_JSON=True in system.env, and start or resume the training."
    if uploaded:
        where = f"s3://{loaded.bucket}/{loaded.model_prefix} has no copy of {path.name}."
        return Absent(where, remedy="Leave out --uploaded to read the log of this machine.")
    return Absent(f"There is no log yet: {path}.", remedy=remedy)


def _name(worker: str, number: int) -> str:
    if worker in ("sim", "reward"):
        return f"{worker}-{number}"
    if worker in completion.LOGS or re.fullmatch(r"(sim|reward)-\d+|reward-evaluation", worker):
        return worker
    raise typer.BadParameter(f"'{worker}' is not one of {', '.join(completion.LOGS)}.")


def _remedy(name: str, workers: int) -> str:
    if name == "reward-evaluation":
        return (
            "Nothing was printed: evaluations call your reward function only with "
            "DR_EVAL_DEBUG_REWARD=True."
        )
    if name == "evaluation":
        return "Start an evaluation with `dr-evaluate`, or add -f to wait for one."
    kind, _, number = name.partition("-")
    if kind in ("sim", "reward") and int(number) >= workers:
        there = "is only worker 0" if workers == 1 else f"are workers 0 to {workers - 1}"
        return f"There {there}: DR_WORKERS is {workers}."
    if kind == "reward":
        return "The reward function has printed nothing yet, or no training was started."
    return "Start a training with `dr-start-training`, or add -f to wait for one."
