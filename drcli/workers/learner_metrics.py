"""Writes the learner's numbers of each iteration, by CleanRL's names: CSV and log."""

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from drcli.base.errors import StorageError
from drcli.base.log import get_logger
from drcli.exchange.iteration import IterationRecord
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing
from drcli.store.growing_file import GrowingFile, Layout, list_parts

if TYPE_CHECKING:
    from drcli.learn.update_result import Stats  # loads torch, which a command does without

_logger = get_logger(__name__)

NUMBER, STEPS = "iteration", "global_step"

ITERATIONS_PER_PART = 64

Row = dict[str, float]


def row_of(record: IterationRecord, stats: "Stats | None" = None) -> Row:
    row: dict[str, float | None] = {
        NUMBER: record.iteration,
        STEPS: record.total_steps,
        "charts/episodic_return": record.mean_reward,
        "charts/episodic_length": record.steps / record.episodes if record.episodes else None,
        "charts/SPS": record.total_steps / record.elapsed_s if record.elapsed_s else None,
        "losses/value_loss": record.value_loss,
        "losses/policy_loss": record.surrogate_loss,
        "losses/approx_kl": record.kl,
        "losses/actor_loss": record.actor_loss,
        "losses/qf_loss": record.critic_loss,
        "losses/alpha": record.alpha,
        "losses/entropy": record.entropy,
        "losses/imitation_loss": record.imitation_loss,
    }
    if stats is not None:
        row |= stats.metrics()
    return {name: x for name, x in row.items() if x is not None and math.isfinite(x)}


def with_losses(record: IterationRecord, stats: "Stats | None") -> IterationRecord:
    numbers = {} if stats is None else stats.metrics()
    return replace(
        record,
        entropy=numbers.get("losses/entropy", math.nan),
        surrogate_loss=numbers.get("losses/policy_loss", math.nan),
        value_loss=numbers.get("losses/value_loss", math.nan),
        kl=numbers.get("losses/approx_kl", math.nan),
        actor_loss=numbers.get("losses/actor_loss"),
        critic_loss=numbers.get("losses/qf_loss"),
        alpha=numbers.get("losses/alpha"),
        imitation_loss=numbers.get("losses/imitation_loss"),
    )


def line_of(row: Row) -> str:
    return "Metrics> " + " ".join(f"{name}={_text(value)}" for name, value in row.items())


class LearnerMetrics:
    """`metrics/learner.csv`: a row for each iteration.

    It never stops a training. After `restore`, only one thread may use it.
    """

    def __init__(self, bucket: Bucket, prefix: str) -> None:
        self._bucket = bucket
        self._key = keys.learner_metrics(prefix)
        self._columns = [NUMBER, STEPS]
        self._file = GrowingFile(
            bucket, self._key, _layout(self._columns), iterations_per_part=ITERATIONS_PER_PART
        )

    def restore(self, history: Iterable[IterationRecord]) -> str | None:
        """Fills gaps from the history; returns what is wrong with the file."""
        problem, written, parts = None, dict[int, Row](), list[str]()
        try:
            parts = list_parts(self._bucket, self._key)
            for key in (self._key, *parts):
                with suppress(ObjectMissing):
                    written |= _read(self._bucket.get(key))
        except (StorageError, ValueError, csv.Error) as error:
            problem = f"{self._bucket.name}/{self._key} cannot be read and is replaced: {error}"
        rows = [(r.iteration, row_of(r) | written.get(r.iteration, {})) for r in history]
        self._columns = columns_of(row for _, row in rows)
        self._file.layout = _layout(self._columns)
        lines = ((iteration, _line(row, self._columns)) for iteration, row in rows)
        self._file.restore(lines, parts, outdated=True)
        return problem

    def add(self, row: Row) -> None:
        columns = columns_of([dict.fromkeys(self._columns, 0.0), row])
        new = len(columns) - len(self._columns)
        if new:
            self._columns = columns
            self._file.replace(_layout(columns), lambda line: line[:-1] + b"," * new + b"\n")
        try:
            self._file.put(int(row[NUMBER]), _line(row, columns))
        except StorageError as error:
            _logger.warning("%s/%s was not written: %s", self._bucket.name, self._key, error)

    def finish(self) -> None:
        self._file.finish()


def columns_of(rows: Iterable[Mapping[str, float]]) -> list[str]:
    return list(dict.fromkeys([NUMBER, STEPS, *(name for row in rows for name in row)]))


def _layout(columns: Sequence[str]) -> Layout:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(columns)  # quotes a name with a comma
    return Layout(text.getvalue().encode(), b"", b"")


def _line(row: Mapping[str, float], columns: Sequence[str]) -> bytes:
    cells = (_text(row[name]) if name in row else "" for name in columns)
    return f"{','.join(cells)}\n".encode()


def _read(data: bytes) -> dict[int, Row]:
    """The readable rows by iteration.

    Raises:
        ValueError, csv.Error: It is another kind of file.
    """
    reader = csv.DictReader(io.StringIO(data.decode(), newline=""))
    if not {NUMBER, STEPS} <= set(reader.fieldnames or ()):
        raise ValueError(f"it has no columns {NUMBER} and {STEPS}")
    rows = {}
    for cells in reader:
        row = {name: x for name, text in cells.items() if (x := _number(name, text)) is not None}
        if NUMBER in row:
            rows[int(row[NUMBER])] = row
    return rows


def _number(name: object, text: object) -> float | None:
    if not isinstance(name, str) or not isinstance(text, str):
        return None  # more or fewer cells than columns
    if name not in (NUMBER, STEPS) and not name.startswith(("charts/", "losses/")):
        return None
    try:
        number = int(text) if name in (NUMBER, STEPS) else float(text)
        return number if math.isfinite(number) else None
    except (ValueError, OverflowError):  # not a number, or an integer larger than any float
        return None


def _text(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6g}"
