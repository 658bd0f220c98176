"""The learner's numbers of each iteration under the names of CleanRL: a CSV file and a log line."""

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

_logger = get_logger(__name__)

NUMBER, STEPS = "iteration", "global_step"

Row = dict[str, float]
"""Numbers of an iteration by name; what is unknown has no name."""


def row_of(record: IterationRecord, stats: Stats | None = None) -> Row:
    """What is known of an iteration.

    Args:
        record: Its place in the history.
        stats: How the update went, at its end; None where only the history still knows.
    """
    row: dict[str, float | None] = {
        NUMBER: record.iteration,
        STEPS: record.total_steps,
        "charts/episodic_return": record.mean_reward,
        "charts/episodic_length": record.steps / record.episodes if record.episodes else None,
        "charts/SPS": record.total_steps / record.elapsed_s if record.elapsed_s else None,
    }
    row |= {
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
    """An iteration in one line of the log."""
    return "Metrics> " + " ".join(f"{name}={_text(value)}" for name, value in row.items())


class LearnerMetrics:
    """`metrics/learner.csv`: a row for each iteration, for pandas and other programs.

    No training needs it, so nothing about it can stop one: what cannot be read is left out, and
    what cannot be written is a line in the log.
    """

    def __init__(self, bucket: Bucket, prefix: str) -> None:
        self._bucket = bucket
        self._key = keys.learner_metrics(prefix)
        self._rows: dict[int, Row] = {}

    def restore(self, history: Iterable[IterationRecord]) -> str | None:
        """Go on with the file that is there.

        Args:
            history: The iterations that are still true. What the file does not know of them, they
                give themselves.

        Returns:
            What is wrong with the file, if anything.
        """
        problem = None
        written: dict[int, Row] = {}
        try:
            written = _read(self._bucket.get(self._key))
        except ObjectMissing:
            pass
        except (StorageError, ValueError, csv.Error) as error:
            problem = f"{self._bucket.name}/{self._key} cannot be read and is written anew: {error}"
        self._rows = {r.iteration: row_of(r) | written.get(r.iteration, {}) for r in history}
        return problem

    def add(self, row: Row) -> None:
        """Append an iteration; `write` publishes it."""
        self._rows[int(row[NUMBER])] = row

    def snapshot(self) -> Sequence[Row]:
        """All rows, for `write` in another thread."""
        return list(self._rows.values())

    def write(self, rows: Sequence[Row]) -> None:
        """Publish the file."""
        try:
            self._bucket.put(self._key, encoded(rows))
        except StorageError as error:
            _logger.warning("%s/%s was not written: %s", self._bucket.name, self._key, error)


def encoded(rows: Sequence[Mapping[str, float]]) -> bytes:
    """Rows as CSV, with a column for each name that any of them has; an empty cell is unknown."""
    columns = dict.fromkeys((NUMBER, STEPS))
    for row in rows:
        columns |= dict.fromkeys(row)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_text(row[name]) if name in row else "" for name in columns] for row in rows)
    return text.getvalue().encode()


def _read(data: bytes) -> dict[int, Row]:
    """The rows of a file by their iteration, as far as they can be read.

    Raises:
        ValueError: It is not such a file.
        csv.Error: Likewise.
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
    """The number in a cell; None where there is none, and in columns of others."""
    if not isinstance(name, str) or not isinstance(text, str):
        return None  # more or fewer cells than columns
    if name not in (NUMBER, STEPS) and not name.startswith(("charts/", "losses/")):
        return None
    try:
        number = int(text) if name in (NUMBER, STEPS) else float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _text(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6g}"
