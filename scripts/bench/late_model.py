"""Makes a trained model look as if it had been trained for thousands of iterations more."""

import json
import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from drcli.model.traces import MOST_ITERATIONS, chosen
from drcli.records.checkpoint import CheckpointName
from drcli.records.episode_metrics import decode_metrics, encode_metrics
from drcli.records.iteration import IterationRecord, decode_history, encode_history

_CHECKPOINT = re.compile(r"(\d+)_Step-(\d+)\.ckpt")


def age(bucket: Path, prefix: str, more: int) -> None:
    """Shift the model in this folder of a bucket by `more` iterations, and fill what is before.

    The training must have stopped. Records, metrics and traces of the new iterations repeat those
    of the real ones; of the traces, there are as many as the retention keeps.
    """
    model = bucket / prefix
    metrics = model / "metrics"
    real = decode_history((metrics / "history.json").read_bytes())
    count = len(real) + more
    records = _records(real, count)
    (metrics / "history.json").write_bytes(encode_history(records))
    steps = records[more - 1].total_steps
    _age_metrics(metrics / "TrainingMetrics.json", count, len(real))
    _age_rows(metrics / "learner.csv", records)
    _age_traces(model / "training-simtrace", count)
    for path in sorted((model / "model").iterdir(), reverse=True):
        text = path.name
        if _CHECKPOINT.match(text):
            path.rename(path.with_name(_shifted(text, more, steps)))
    for path in (model / "model").glob("*.ckpt.json"):
        fields = json.loads(path.read_text())
        fields["name"] = _shifted(fields["name"], more, steps)
        number = CheckpointName.parse(fields["name"])
        learned = fields["counters"].get("learned")
        if learned is not None and number is not None:
            fields["counters"]["learned"] = json.loads(
                json.dumps(records[number.number - 1].to_json()).replace("NaN", "null")
            )
        path.write_text(json.dumps(fields))
    for name in (".coach_checkpoint", "deepracer_checkpoints.json"):
        path = model / "model" / name
        path.write_text(_shifted(path.read_text(), more, steps))


def _shifted(text: str, more: int, steps: int) -> str:
    """The text with all names of checkpoints shifted."""
    return _CHECKPOINT.sub(
        lambda found: f"{int(found[1]) + more}_Step-{int(found[2]) + steps}.ckpt", text
    )


def _records(real: list[IterationRecord], count: int) -> list[IterationRecord]:
    records: list[IterationRecord] = []
    total = 0
    for iteration in range(count):
        # The last ones are the real ones.
        like = real[(iteration - count) % len(real)]
        checkpoint = str(CheckpointName(iteration, total))
        total += like.steps
        records.append(
            replace(
                like,
                iteration=iteration,
                checkpoint=checkpoint,
                total_steps=total,
                elapsed_s=float(iteration),
            )
        )
    return records


def _age_metrics(path: Path, count: int, known: int) -> None:
    by_iteration: dict[int, list[Any]] = {}
    for record in decode_metrics(path.read_bytes()):
        by_iteration.setdefault(record.iteration or 0, []).append(record)
    found, clock_ms = [], 0.0
    most = max(record.trial for each in by_iteration.values() for record in each)
    for iteration in range(count):
        for record in by_iteration.get((iteration - count) % known, []):
            length_ms = record.elapsed_time_in_milliseconds
            found.append(
                replace(
                    record,
                    iteration=iteration,
                    episode=iteration * most + record.trial,
                    start_time=clock_ms,
                    metric_time=clock_ms + length_ms,
                )
            )
            clock_ms += length_ms
    path.write_bytes(encode_metrics(found, "progress"))


def _age_rows(path: Path, records: list[IterationRecord]) -> None:
    head, *lines = path.read_text().splitlines()
    rows = [line.split(",", 2)[2] for line in lines]
    aged = [
        f"{r.iteration},{r.total_steps},{rows[(r.iteration - len(records)) % len(rows)]}"
        for r in records
    ]
    path.write_text("\n".join([head, *aged, ""]))


def _age_traces(folder: Path, count: int) -> None:
    """Hard links, which take no space, to the real traces."""
    kept = folder.with_name("real-traces")
    folder.rename(kept)
    folder.mkdir()
    real = sorted(kept.iterdir())
    sizes = {n: real[n % len(real)].stat().st_size for n in range(count)}
    gone = set(chosen(sizes, count - 1, 1 << 60, MOST_ITERATIONS))
    for n in sizes.keys() - gone:
        os.link(real[n % len(real)], folder / f"{n}-iteration.csv")
    for path in real:
        path.unlink()
    kept.rmdir()
