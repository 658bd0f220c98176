"""Writes the learner's numbers of each iteration, by CleanRL's names: a CSV file and a log line."""

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence

from drcli.base.errors import StorageError
from drcli.base.log import get_logger
from drcli.exchange.iteration import IterationRecord
from drcli.learn.update_result import Stats
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing

_logger = get_logger(__name__)

NUMBER, STEPS = "iteration", "global_step"

Row = dict[str, float]
"""Numbers of an iteration by name; unknown ones are left out."""


def row_of(record: IterationRecord, stats: Stats | None = None) -> Row:
    """The numbers of an iteration from the history and, if it was learned just now, its update."""
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
    }
    if stats is not None:
        row |= stats.metrics()
    return {name: x for name, x in row.items() if x is not None and math.isfinite(x)}


def line_of(row: Row) -> str:
    """The log line of an iteration."""
    return "Metrics> " + " ".join(f"{name}={_text(value)}" for name, value in row.items())


class LearnerMetrics:
    """`metrics/learner.csv`: a row for each iteration, for pandas and other programs.

    No training needs this file, so it never stops one: unreadable cells are left out, and the log
    says when the file cannot be written.
    """

    def __init__(self, bucket: Bucket, prefix: str) -> None:
        self._bucket = bucket
        self._key = keys.learner_metrics(prefix)
        self._rows: dict[int, Row] = {}

    def restore(self, history: Iterable[IterationRecord]) -> str | None:
        """Continue the file with the iterations of the history, which fill its gaps.

        Returns:
            What is wrong with the file, or None.
        """
        problem, written = None, dict[int, Row]()
        try:
            written = _read(self._bucket.get(self._key))
        except ObjectMissing:
            pass
        except (StorageError, ValueError, csv.Error) as error:
            problem = f"{self._bucket.name}/{self._key} cannot be read and is replaced: {error}"
        self._rows = {r.iteration: row_of(r) | written.get(r.iteration, {}) for r in history}
        return problem

    def add(self, row: Row) -> None:
        """Append an iteration."""
        self._rows[int(row[NUMBER])] = row

    def snapshot(self) -> Sequence[Row]:
        """The rows for `write`, which may run in another thread."""
        return list(self._rows.values())

    def write(self, rows: Sequence[Row]) -> None:
        """Publish the file."""
        try:
            self._bucket.put(self._key, encoded(rows))
        except StorageError as error:
            _logger.warning("%s/%s was not written: %s", self._bucket.name, self._key, error)


def encoded(rows: Sequence[Mapping[str, float]]) -> bytes:
    """Rows as CSV, with a column for each name; unknown numbers are empty cells."""
    columns = dict.fromkeys([NUMBER, STEPS, *(name for row in rows for name in row)])
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _text(value) for name, value in row.items()} for row in rows)
    return text.getvalue().encode()


def _read(data: bytes) -> dict[int, Row]:
    """The readable rows of a file by iteration.

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
    """The number in a cell; None if it has none or the column is not ours."""
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
