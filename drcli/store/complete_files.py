"""Growing files of a running training, read as if complete."""

import csv
import io
from collections import Counter
from collections.abc import Callable, Sequence

from drcli.base.json_record import RecordError, parse_json
from drcli.exchange.episode_metrics import EpisodeMetrics, decode_metrics, encode_metrics
from drcli.exchange.iteration import IterationRecord, decode_history, encode_history
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.growing_file import read_parts


def read_complete(bucket: Bucket, key: str) -> bytes:
    """With its parts; ObjectMissing without any. Damage is left to others."""
    name = key.rpartition("/")[2]
    combine: Callable[[bytes, Sequence[bytes]], bytes] | None = None
    if name == keys.history("").rpartition("/")[2]:
        combine = _history
    elif name == keys.learner_metrics("").rpartition("/")[2]:
        combine = _rows
    elif name.startswith("TrainingMetrics") and name.endswith(".json"):
        combine = _metrics
    parts = read_parts(bucket, key, bucket.get) if combine is not None else []
    whole = bucket.get(key)
    if combine is None or not parts:
        return whole
    try:
        return combine(whole, parts)
    except (RecordError, ValueError, csv.Error):
        return whole


def combined_history(
    whole: Sequence[IterationRecord], parts: Sequence[Sequence[IterationRecord]]
) -> list[IterationRecord]:
    if not parts:
        return list(whole)
    known = {record.iteration: record for record in whole}
    for part in parts:
        for record in part:
            before = known.get(record.iteration, record)
            if len(before.evaluation_progress) <= len(record.evaluation_progress):
                known[record.iteration] = record
    return [known[iteration] for iteration in sorted(known)]


def combined_metrics(
    whole: Sequence[EpisodeMetrics], parts: Sequence[Sequence[EpisodeMetrics]]
) -> list[EpisodeMetrics]:
    if not parts:
        return list(whole)
    in_parts: dict[int, list[EpisodeMetrics]] = {}
    for part in parts:
        for record in part:
            in_parts.setdefault(record.iteration or 0, []).append(record)
    counts = Counter(record.iteration for record in whole)
    newer = {n: of_n for n, of_n in in_parts.items() if len(of_n) >= counts[n]}
    records = [record for record in whole if record.iteration not in newer]
    records += [record for of_n in newer.values() for record in of_n]
    return sorted(records, key=lambda record: -1 if record.iteration is None else record.iteration)


def _history(whole: bytes, parts: Sequence[bytes]) -> bytes:
    return encode_history(combined_history(decode_history(whole), list(map(decode_history, parts))))


def _metrics(whole: bytes, parts: Sequence[bytes]) -> bytes:
    records = combined_metrics(decode_metrics(whole), list(map(decode_metrics, parts)))
    return encode_metrics(records, parse_json(whole).get("best_model_metric", "progress"))


def _rows(whole: bytes, parts: Sequence[bytes]) -> bytes:
    found: dict[int, dict[str, str]] = {}
    columns: dict[str, None] = {}
    for data in (whole, *parts):
        reader = csv.DictReader(io.StringIO(data.decode(), newline=""))
        columns |= dict.fromkeys(reader.fieldnames or ())
        found |= {int(next(iter(row.values()))): row for row in reader}
    text = io.StringIO()
    writer = csv.DictWriter(text, list(columns), lineterminator="\n")
    writer.writeheader()
    writer.writerows(found[iteration] for iteration in sorted(found))
    return text.getvalue().encode()
