"""Writes an export so that nobody finds a part of it."""

import contextlib
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from drcli.base.atomic_file import remedy_for, rewrite
from drcli.base.errors import SettingsError
from drcli.base.private_files import hand_out, make_folder
from drcli.base.problems import shown
from drcli.config.settings import Settings
from drcli.exchange.scores import NOT_EVALUATED, Score, encode_single
from drcli.models.checkpoint_files import Item
from drcli.models.put_model import POINTERS, Delivery, Progress
from drcli.models.transfer_buckets import (
    COPY_PATIENCE_S,
    parse_url,
    refuse_nesting,
    refuse_overlap,
    refuse_training,
    source_bucket,
)
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.store.write_probe import prove_writing

_URL = "s3://"


@dataclass(frozen=True)
class ExportTarget:
    shown: str
    folder: Path | None = None
    bucket: Bucket | None = None
    prefix: str = ""


def is_url(out: str) -> bool:
    return out.casefold().startswith(_URL)


def export_target(
    settings: Settings, out: str, source: str, *, local: bool, force: bool
) -> ExportTarget:
    """Check where an export should go, at most with a test object.

    Raises:
        SettingsError: The place cannot be used.
        StorageError: The bucket cannot be reached.
    """
    if not is_url(out):
        return ExportTarget(
            out, folder=_usable_folder(Path(out).expanduser().resolve(), force=force)
        )
    name, prefix = parse_url(out, "--out")
    bucket = source_bucket(settings.transfer, name, local=local, patience_s=COPY_PATIENCE_S)
    there = bucket.list(keys.folder(prefix))
    here = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    refuse_overlap((here, source), (bucket, prefix), flag="--out", may_write=True)
    if local:
        refuse_nesting(bucket, prefix, settings.custom_files_prefix, flag="--out")
    refuse_training(bucket, prefix)
    if there and not force:
        raise SettingsError(
            f"{out} is not empty: it has {there[0].key.removeprefix(keys.folder(prefix))}.",
            remedy="Choose another prefix with --out, or replace the files there with -f "
            "(--force).",
        )
    prove_writing(bucket, prefix, deletes=force)
    return ExportTarget(f"{_URL}{name}/{prefix}", bucket=bucket, prefix=prefix)


def write_items(
    target: ExportTarget, items: Sequence[Item], score: Score, progress: Progress
) -> None:
    """The two pointers come last; raises DrError."""
    pointers = pointer_items(score)
    if target.folder is not None:
        _write_folder(target.folder, [*items, *pointers])
    elif target.bucket is not None:
        with progress("Uploading export", sum(len(item.data) for item in items)) as watch:
            delivery = Delivery(target.bucket, target.prefix, watch)
            if any(map(delivery.differs, items)):
                delivery.withdraw()  # the files there are of another model or checkpoint
            delivery.send(items)
            delivery.publish(score)


def pointer_items(score: Score) -> list[Item]:
    contents = (score.name.encode(), encode_single(score))
    return [Item(name, data) for name, data in zip(POINTERS, contents, strict=True)]


def reference_score(score: Score) -> Score:
    metric = NOT_EVALUATED if score.avg_eval_metric is None else score.avg_eval_metric
    return replace(score, avg_eval_metric=metric, episodes=None)


def write_archive(path: Path, data: bytes) -> None:
    """In one step, with its folder if needed."""
    try:
        make_folder(path.parent)
    except OSError as e:
        raise _unwritable(path.parent, e) from e
    rewrite(path, data)


def _usable_folder(folder: Path, *, force: bool) -> Path:
    try:
        if folder.exists() and not folder.is_dir():
            raise SettingsError(
                f"--out {shown(str(folder))} is a file.", remedy="Name a folder with --out."
            )
        if folder.is_dir() and any(folder.iterdir()) and not force:
            raise SettingsError(
                f"--out {shown(str(folder))} is not empty.",
                remedy="Choose another folder with --out, or replace the files there with -f "
                "(--force).",
            )
    except OSError as e:
        raise _unwritable(folder, e) from e
    return folder


def _write_folder(folder: Path, items: Sequence[Item]) -> None:
    try:
        if folder.is_dir() and any(folder.iterdir()):
            # Without pointers, nobody takes new files for those of the old checkpoint.
            for name in reversed(POINTERS):
                (folder / name).unlink(missing_ok=True)
            _write_files(folder, items)
            return
        make_folder(folder.parent)
        scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            hand_out(scratch)
            _write_files(scratch, items)
            scratch.replace(folder)  # also onto an empty folder
        except BaseException:
            with contextlib.suppress(OSError):
                shutil.rmtree(scratch)
            raise
    except OSError as e:
        raise _unwritable(folder, e) from e


def _write_files(folder: Path, items: Sequence[Item]) -> None:
    for item in items:
        path = folder / item.name
        make_folder(path.parent)
        rewrite(path, item.data)


def _unwritable(folder: Path, error: OSError) -> SettingsError:
    return SettingsError(
        f"--out {shown(str(folder))}: cannot be written ({error.strerror or error}).",
        remedy=remedy_for(error, folder, f"Check that you can write {folder.parent}."),
    )
