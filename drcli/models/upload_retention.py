"""Which uploaded checkpoints and car archives stay, and which are deleted.

Deletes only what this program wrote, and never what the pointers name.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass

from drcli.base import notices
from drcli.base.errors import SettingsError
from drcli.base.json_record import RecordError
from drcli.base.problems import BadValue
from drcli.config.unattended_types import retention_rules
from drcli.exchange.checkpoint import CheckpointName, CheckpointRecord
from drcli.formats.car_rules import END
from drcli.models.put_model import Delivery
from drcli.store import keys
from drcli.store.best_checkpoint import read_scores
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing

_GRAPH = re.compile(r"model_(\d+)\.pb")


@dataclass(frozen=True)
class Retention:
    """`rules` are `last`, `last-N`, `best`, `every-N`; none: keep all."""

    rules: tuple[str, ...] = ()
    max_bytes: int = 0

    @staticmethod
    def of(keep: str, max_mb: int) -> "Retention":
        try:
            return Retention(retention_rules(keep), max_mb * 1_000_000)
        except BadValue as error:
            raise SettingsError(f"--keep '{keep}' {error}.", remedy=error.remedy) from error

    @property
    def is_active(self) -> bool:
        return bool(self.rules) or self.max_bytes > 0


KEEP_ALL = Retention()


def surplus(
    sizes: Mapping[CheckpointName, int],
    retention: Retention,
    best: CheckpointName | None,
    pinned: Collection[CheckpointName],
) -> list[CheckpointName]:
    """What does not stay, oldest first; `pinned` ones always stay.

    `every-N` keeps the first of 0 to N-1, of N to 2N-1 ...: what it keeps once, it keeps always.
    The size limit deletes the oldest first, the best last.
    """
    everything = sorted(sizes)
    stay = set(everything) if not retention.rules else _kept(everything, retention.rules, best)
    stay |= set(pinned) & set(everything)
    if retention.max_bytes:
        first_to_go = sorted(stay - set(pinned), key=lambda name: (name == best, name))
        for name in first_to_go:
            if sum(sizes[each] for each in stay) <= retention.max_bytes:
                break
            stay.discard(name)
    return [name for name in everything if name not in stay]


def delete_surplus_checkpoints(
    delivery: Delivery, retention: Retention, best: str | None, *, dry_run: bool = False
) -> list[str]:
    bucket, prefix = delivery.bucket, delivery.prefix
    objects, sizes = _own_checkpoints(bucket, prefix)
    pinned = _pointed(bucket, prefix)
    doomed = surplus(sizes, retention, CheckpointName.parse(best or ""), pinned)
    left = sum(sizes.values()) - sum(sizes[name] for name in doomed)
    _warn_of_size(left, retention, f"s3://{bucket.name}/{prefix}")
    names = [key for name in doomed for key in objects[name]]
    if not dry_run:
        bucket.delete(names)
    return [key.removeprefix(keys.folder(prefix)) for key in names]


def delete_surplus_archives(
    bucket: Bucket,
    prefix: str,
    plain: Collection[str],
    retention: Retention,
    best: str | None,
    newest: int,
    *,
    dry_run: bool = False,
) -> list[str]:
    """Of `NAME-chkN.tar.gz`; `plain` names and `newest` always stay."""
    names = "|".join(re.escape(name.removesuffix(END)) for name in plain)
    pattern = re.compile(rf"(?:{names})-chk(\d{{1,9}}){re.escape(END)}")
    folder = keys.folder(prefix)
    archives: defaultdict[CheckpointName, list[str]] = defaultdict(list)
    sizes: Counter[CheckpointName] = Counter()
    for info in bucket.list(folder):
        found = pattern.fullmatch(info.key.removeprefix(folder))
        if found is not None:
            name = CheckpointName(int(found[1]), 0)
            archives[name].append(info.key)
            sizes[name] += info.size_bytes
    parsed = CheckpointName.parse(best or "")
    best_archive = None if parsed is None else CheckpointName(parsed.number, 0)
    doomed = surplus(sizes, retention, best_archive, [CheckpointName(newest, 0)])
    left = sum(sizes.values()) - sum(sizes[name] for name in doomed)
    _warn_of_size(left, retention, f"s3://{bucket.name}/{prefix}")
    deleted = [key for name in doomed for key in archives[name]]
    if not dry_run:
        bucket.delete(deleted)
    return [key.removeprefix(folder) for key in deleted]


def _kept(
    names: list[CheckpointName], rules: tuple[str, ...], best: CheckpointName | None
) -> set[CheckpointName]:
    stay: set[CheckpointName] = set()
    for rule in rules:
        kind, _, number = rule.partition("-")
        if kind == "last":
            stay |= set(names[-int(number or 1) :])
        elif kind == "best":
            stay |= {best} & set(names) if best is not None else set()
        else:
            first: dict[int, CheckpointName] = {}
            for name in names:
                first.setdefault(name.number // int(number), name)
            stay |= set(first.values())
    return stay


def _own_checkpoints(
    bucket: Bucket, prefix: str
) -> tuple[dict[CheckpointName, list[str]], dict[CheckpointName, int]]:
    listed = bucket.list(keys.model_folder(prefix))
    objects: dict[CheckpointName, list[str]] = {}
    sizes: dict[CheckpointName, int] = {}
    for info in listed:
        name = keys.checkpoint_of(prefix, info.key)
        if name is not None:
            objects.setdefault(name, []).append(info.key)
            sizes[name] = sizes.get(name, 0) + info.size_bytes
    ours = {name for name in objects if _is_ours(bucket, prefix, name, objects[name])}
    numbers = [name.number for name in objects]
    for info in listed:
        found = _GRAPH.fullmatch(info.key.removeprefix(keys.model_folder(prefix)))
        if found is None or numbers.count(int(found[1])) != 1:
            continue
        for name in ours:
            if name.number == int(found[1]):
                objects[name].append(info.key)
                sizes[name] += info.size_bytes
    return (
        {name: found for name, found in objects.items() if name in ours},
        {name: size for name, size in sizes.items() if name in ours},
    )


def _is_ours(bucket: Bucket, prefix: str, name: CheckpointName, found: list[str]) -> bool:
    record = keys.checkpoint_record(prefix, str(name))
    if record not in found or keys.checkpoint_tensors(prefix, str(name)) not in found:
        return False
    try:
        CheckpointRecord.decode_of(str(name), bucket.get(record))
    except (RecordError, ObjectMissing):
        return False
    return True


def _pointed(bucket: Bucket, prefix: str) -> set[CheckpointName]:
    names: set[str] = set()
    with suppress(ObjectDamaged):
        scores = read_scores(bucket, prefix)
        if scores is not None:
            names |= {scores.best_checkpoint.name, scores.last_checkpoint.name}
    with suppress(ObjectMissing):
        names.add(bucket.get(keys.coach_checkpoint(prefix)).decode(errors="replace").strip())
    return {name for name in map(CheckpointName.parse, names) if name is not None}


def _warn_of_size(left: int, retention: Retention, place: str) -> None:
    if retention.max_bytes and left > retention.max_bytes:
        notices.warn(
            f"What must stay at {place} takes {left / 1e6:,.0f} MB, more than the limit of "
            f"{retention.max_bytes / 1e6:,.0f} MB (DR_UPLOAD_MAX_MB)."
        )
