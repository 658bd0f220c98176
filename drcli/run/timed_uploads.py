"""Uploads a model by the clock, at new best checkpoints, and at ends before its goal.

Each upload is a command of its own, which cannot hold up the training; one runs at a time.
"""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.files import rewrite
from drcli.base.log import get_logger
from drcli.config.run_config import UnattendedConfig
from drcli.metrics.event_file import FROM_HISTORY, PATTERN
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.job import Job
from drcli.run.checkpoint_watch import CheckpointWatch
from drcli.run.command_process import CommandEnd, CommandProcess, Start
from drcli.run.duty import Duty, RunningTraining
from drcli.run.outcome import INTERRUPTED, Ending, Outcome

_logger = get_logger(__name__)

BEST_EVERY_S = 300.0
"""At first, each evaluation is a new best."""

RUNNING_SHARE = 0.5
"""Of the time left at an interruption, for an upload that runs then."""

STOPPED_PATIENCE_S, STOPPED_UPLOAD_S = 5.0, 30.0
"""For an upload that runs when somebody stops the training, and for it with the last one."""


@dataclass
class Upload:
    """`every_s` None: for each new checkpoint, `BEST_EVERY_S` apart. `due_s` is monotonic."""

    name: str
    command: tuple[str, ...]
    every_s: float | None
    best: bool = False
    due_s: float = 0.0
    done: str = ""
    problem: str = ""


BEST = ("upload-model", "-b", "-f", "--json")
LAST = ("upload-model", "-f", "--json")


def uploads_models(settings: UnattendedConfig) -> bool:
    """Whether the target is to have the best model at every end."""
    return bool(
        settings.regular_upload or settings.upload_best_model or settings.upload_model_on_completion
    )


def wanted_uploads(job: Job) -> list[Upload]:
    settings = job.config.unattended
    found = []
    if settings.regular_upload:
        every_s = 60.0 * settings.regular_upload
        found.append(Upload("last checkpoint", LAST, every_s))
    if settings.upload_best_model:
        found.append(Upload("best checkpoint", BEST, None, best=True))
    if settings.regular_physical_model_upload:
        every_s = 60.0 * settings.regular_physical_model_upload
        command = ("upload-car-zip", "-f", "-L", "--only-numbered", "--json")
        found.append(Upload("car archive", command, every_s))
    return found


class TimedUploads(Duty):
    name = "uploads"

    def __init__(
        self,
        run: RunningTraining,
        watch: CheckpointWatch,
        *,
        start: Start = CommandProcess,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(run)
        self._watch = watch
        self._start = start
        self._clock = clock
        self._uploads = wanted_uploads(run.job)
        self._at_end = uploads_models(run.job.config.unattended)
        self._at_target = ""
        self._running: tuple[Upload, CommandProcess] | None = None

    def start(self) -> None:
        now_s = self._clock()
        for upload in self._uploads:
            upload.due_s = now_s + (upload.every_s or 0.0)
        if self._uploads or self._at_end:
            self._watch.turn_on()

    def check(self) -> Outcome | None:
        if self._running is not None:
            upload, process = self._running
            end = process.poll()
            if end is None:
                return None
            self._running = None
            self._note(upload, end)
        now_s = self._clock()
        for upload in self._uploads:
            if now_s >= upload.due_s and self._is_new(upload):
                self._begin(upload, now_s)
                break
        return None

    def finish(self, ending: Ending) -> None:
        """Complete trainings: `drcli.run.end_of_training`."""
        hurried = ending.outcome.code == INTERRUPTED or ending.deadline_s is not None
        complete = ending.outcome.code == 0
        until_s = self._clock() + STOPPED_UPLOAD_S
        if self._running is not None:
            upload, process = self._running
            self._running = None
            patience_s = ending.left_s(RUNNING_SHARE) if hurried else STOPPED_PATIENCE_S
            if complete and not hurried:
                patience_s = float("inf")
            self._wait(upload, process, patience_s, ending)
        if complete or not (self._uploads or self._at_end):
            return
        self._watch.look_last(ending.left_s(0.1))
        score = self._watch.best or self._watch.last
        if self._at_end and score is not None and score.name != self._at_target:
            is_best = score is self._watch.best
            name = "best checkpoint" if is_best else "last checkpoint"
            left_s = ending.left_s()
            if not hurried:
                left_s = min(left_s, until_s - self._clock())
            self._upload_last(Upload(name, BEST if is_best else LAST, None), left_s, ending)
        for upload in self._uploads if hurried else ():
            if upload.command[0] != "upload-model" and self._is_new(upload):
                self._upload_last(upload, ending.left_s(), ending)

    def _upload_last(self, upload: Upload, within_s: float, ending: Ending) -> None:
        if within_s > 0.0:
            self._wait(upload, self._start(self.run.job, *upload.command), within_s, ending)

    def _wait(
        self, upload: Upload, process: CommandProcess, within_s: float, ending: Ending
    ) -> None:
        end = process.wait(within_s, lambda: ending.left_s() <= 0.0)
        self._note(upload, end, ends=True)

    def after_release(self, ending: Ending) -> None:
        """`finish` is not called if the model was lost."""
        if self._running is not None:
            self._running[1].kill()
            self._running = None

    def _is_new(self, upload: Upload) -> bool:
        score = self._watch.best if upload.best else self._watch.last
        return score is not None and score.name != upload.done

    def _begin(self, upload: Upload, now_s: float) -> None:
        # Also if it fails: a bucket in trouble is not asked without a pause.
        upload.due_s = now_s + (BEST_EVERY_S if upload.every_s is None else upload.every_s)
        self._running = upload, self._start(self.run.job, *upload.command)

    def _note(self, upload: Upload, end: CommandEnd, *, ends: bool = False) -> None:
        if end.ok:
            upload.done = str(end.report.get("checkpoint", ""))
            if upload.command[0] == "upload-model":
                self._at_target = upload.done
            target = end.report.get("target") or next(iter(end.report.get("files", [])), "")
            size = end.report.get("copied_bytes", end.report.get("size_bytes", 0))
            text = f"Uploaded the {upload.name} {upload.done} to {target} in {end.seconds:.0f} s."
            _logger.info("%s", text)
            if upload.problem:
                self.run.journal.note("recovery", f"The upload of the {upload.name} works again.")
            self.run.journal.note(
                "upload",
                text,
                what=upload.name,
                checkpoint=upload.done,
                target=target,
                bytes=size,
                seconds=round(end.seconds, 1),
            )
            upload.problem = ""
            return
        again = "" if end.killed or ends else " It is tried again at its next time."
        text = f"The upload of the {upload.name} failed: {end.reason}{again}"
        if text != upload.problem:
            _logger.warning("%s", text)
            self.run.journal.note("fault", text, event="upload", what=upload.name)
        upload.problem = text


# TensorBoard event files in the bucket, where they outlive a spot machine.


_NAME = re.compile(r"events\.out\.tfevents\.[A-Za-z0-9._-]+")


class EventFileCopies:
    """Uploads event files that have grown; above `max_bytes`, the oldest go.

    The files of other machines stay: TensorBoard drops what a later file has again.
    """

    def __init__(self, model: ModelStore, folder: Path, max_bytes: int) -> None:
        self._model = model
        self._folder = folder
        self._max_bytes = max_bytes
        self._copied: dict[str, int] | None = None

    def update(self, over: Callable[[], bool] = lambda: False, *, hurried: bool = False) -> None:
        """Upload until `over()`; if `hurried`, the newest file comes first.

        Raises:
            StorageError: The bucket does not answer, or refuses.
            OSError: A file cannot be read.
        """
        if not self._folder.is_dir():
            return
        if self._copied is None:
            self._copied = copied_sizes(self._model)
        kept = self._kept(self._copied)
        for name in sorted(kept, reverse=hurried):
            path = self._folder / name
            if over() or not path.is_file():
                continue
            if path.stat().st_size > self._copied.get(name, -1):
                data = path.read_bytes()
                self._model.bucket.put(keys.event_file(self._model.prefix, name), data)
                self._copied[name] = len(data)
        for name in sorted(set(self._copied) - kept):
            self._model.bucket.delete([keys.event_file(self._model.prefix, name)])
            del self._copied[name]

    def left_bytes(self) -> int:
        copied = self._copied or {}
        sizes = local_sizes(self._folder)
        return sum(max(0, sizes.get(n, 0) - copied.get(n, 0)) for n in self._kept(copied))

    def _kept(self, copied: dict[str, int]) -> set[str]:
        sizes, kept, total = copied | local_sizes(self._folder), set(), 0
        for name in sorted(sizes, reverse=True):
            total += sizes[name]
            if total > self._max_bytes:
                break
            kept.add(name)
        return kept


def fetch_event_files(model: ModelStore, folder: Path, max_bytes: int) -> bool:
    """Download a model's event files that this machine lacks; whether any was new.

    Older files than those here stay away: the first file of a machine begins with all earlier
    iterations. One made of the history gives way to real ones.

    Raises:
        StorageError: The bucket cannot be read.
        SettingsError: A file cannot be written.
    """
    there = copied_sizes(model)
    here = local_sizes(folder)
    made_here = {name for name in here if name.endswith(FROM_HISTORY) and name not in there}
    replaced = made_here if there and made_here == set(here) else set()
    oldest_wanted = max(set(here) - replaced, default="")
    fetched, total = False, 0
    wanted = [name for name, size in there.items() if size > here.get(name, -1)]
    for name in sorted(wanted, reverse=True):
        total += there[name]
        if name < oldest_wanted or total > max_bytes:
            continue
        data = model.bucket.get(keys.event_file(model.prefix, name))
        path = folder / name
        try:
            fetched = _extend(path, data) or fetched
        except OSError as error:
            raise SettingsError(
                f"{path}: cannot be written ({error.strerror or error}).",
                remedy=f"Check that you can write {folder}, and that its disk has room.",
            ) from None
    if fetched:
        for name in replaced:
            (folder / name).unlink(missing_ok=True)
    return fetched


def copied_sizes(model: ModelStore) -> dict[str, int]:
    folder = keys.event_folder(model.prefix)
    return {
        name: info.size_bytes
        for info in model.bucket.list(folder)
        if _NAME.fullmatch(name := info.key.removeprefix(folder))
    }


def local_sizes(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_size for path in folder.glob(PATTERN) if path.is_file()}


def _extend(path: Path, data: bytes) -> bool:
    """Only what it lacks at its end: TensorBoard may be reading it."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        rewrite(path, data)
        return True
    own = path.read_bytes()
    if len(data) <= len(own) or not data.startswith(own):
        return False
    with path.open("ab") as file:
        file.write(data[len(own) :])
    return True
