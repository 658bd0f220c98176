"""The learning curve of a model, in an object that grows."""

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import replace

from drcli.bucket.bucket import ObjectInfo, ObjectMissing, read_record
from drcli.model import keys
from drcli.model.growing_file import (
    GrowingFile,
    Layout,
    combined_history,
    list_parts,
    read_growing,
    write_whole,
)
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName
from drcli.records.iteration import (
    HISTORY_END,
    HISTORY_HEAD,
    SEPARATOR,
    IterationRecord,
    decode_history,
    encode_history,
    encode_iteration,
)
from drcli.records.scores import EvaluationResult

LAYOUT = Layout(HISTORY_HEAD, SEPARATOR, HISTORY_END)

ITERATIONS_PER_PART = 64

REMEMBERED = 1000
"""Goals and scores need fewer."""

SMOOTH = 3
_PEAK = 40.0
FALL_SHARE = 0.6


class History:
    """All iterations of a model. Only the trainer writes it.

    Attributes:
        records: All until the first is added; then the newest `REMEMBERED` at least, and the newest
            evaluated ones.
    """

    def __init__(self, model: ModelStore) -> None:
        self._file = GrowingFile(
            model.bucket,
            keys.history(model.prefix),
            LAYOUT,
            iterations_per_part=ITERATIONS_PER_PART,
        )
        self.records = read_history(model)
        self.count = len(self.records)
        self._file.restore(
            ((r.iteration, encode_iteration(r)) for r in self.records),
            list_parts(model.bucket, keys.history(model.prefix)),
        )
        self._steps = array("q", (r.steps for r in self.records))
        self._fall = Fall(self.records)

    def restore(self, iteration: int, last: IterationRecord | None) -> None:
        """Go back to when a checkpoint was published, dropping its iteration and later ones.

        `last` is the record in the checkpoint, published before the history: a trainer may end
        between.
        """
        self.records = [r for r in self.records if r.iteration < iteration]
        self._file.drop_from(iteration)
        self.count = len(self.records)
        self._steps = array("q", (r.steps for r in self.records))
        self._fall = Fall(self.records)
        if last is not None and last.iteration not in {r.iteration for r in self.records}:
            self._append(last)
        self._file.write()

    def add(self, record: IterationRecord) -> None:
        self._append(record)
        if len(self.records) > 2 * REMEMBERED:
            older = [r for r in self.records[:-REMEMBERED] if r.evaluation_progress]
            self.records = older[-REMEMBERED:] + self.records[-REMEMBERED:]

    def add_evaluation(self, iteration: int, result: EvaluationResult) -> None:
        for at in reversed(range(len(self.records))):
            if self.records[at].iteration == iteration:
                changed = with_evaluation(self.records[at], result)
                self.records[at] = changed
                self._file.put(iteration, encode_iteration(changed))
                break

    def iterations_of(self, steps: int) -> int:
        count = 0
        while steps > 0 and count < len(self._steps):
            count += 1
            steps -= self._steps[-count]
        return count

    def collapse(self, best: str | None) -> str | None:
        return self._fall.sentence(best)

    def finish(self) -> None:
        """Write the whole object for other programs."""
        self._file.finish()

    def _append(self, record: IterationRecord) -> None:
        self.records.append(record)
        self.count += 1
        self._steps.append(record.steps)
        self._fall.add(record)
        self._file.put(record.iteration, encode_iteration(record))


def with_evaluation(record: IterationRecord, result: EvaluationResult) -> IterationRecord:
    again, second = result.confirmation, result.second
    return replace(
        record,
        evaluation_progress=result.progress,
        evaluation_lap_s=result.lap_s,
        evaluation_steering_per_m=result.steering_per_m,
        confirmation_progress=[] if again is None else again.progress,
        confirmation_lap_s=[] if again is None else again.lap_s,
        second_world="" if second is None else second.world,
        second_progress=[] if second is None else second.progress,
        second_lap_s=[] if second is None else second.lap_s,
    )


class HistoryReader:
    def __init__(self) -> None:
        self._known: dict[str, tuple[ObjectInfo, list[IterationRecord]]] = {}

    def read(self, model: ModelStore) -> list[IterationRecord]:
        """Only what changed; oldest first. Raises ObjectDamaged."""
        key = keys.history(model.prefix)
        listed = model.bucket.list(key.rpartition("/")[0] + "/")
        infos = {
            i.key: i for i in listed if i.key == key or keys.part_number(key, i.key) is not None
        }
        self._known = {
            key: found for key, found in self._known.items() if found[0] == infos.get(key)
        }
        for each in sorted(infos, reverse=True):  # the whole object last, see `read_parts`
            if each not in self._known:
                try:
                    records = read_record(model.bucket, each, decode_history)
                except ObjectMissing:  # deleted since the listing: the whole object has it
                    self._known.clear()
                    return read_history(model)
                self._known[each] = infos[each], records
        parts = [self._known[part][1] for part in sorted(infos) if part != key]
        return combined_history(self._known[key][1] if key in infos else [], parts)


def read_history(model: ModelStore) -> list[IterationRecord]:
    key = keys.history(model.prefix)
    return read_growing(model.bucket, key, decode_history, combined_history)


def write_history(model: ModelStore, records: Sequence[IterationRecord]) -> None:
    write_whole(model.bucket, keys.history(model.prefix), encode_history(records))


class Fall:
    def __init__(self, records: Iterable[IterationRecord] = ()) -> None:
        self._newest: list[float] = []
        self._highest = self._last = 0.0
        self._before: IterationRecord | None = None
        for record in records:
            self.add(record)

    def add(self, record: IterationRecord) -> None:
        if self._before is not None and not record.continues(self._before):
            self._newest, self._highest, self._last = [], 0.0, 0.0  # it drove another track
        self._before = record
        if not record.is_own_driving:
            return  # fewer and fewer episodes are a teacher's: that is no fall
        self._newest = [*self._newest, record.mean_progress][-SMOOTH:]
        if len(self._newest) == SMOOTH:
            self._last = sum(self._newest) / SMOOTH
            self._highest = max(self._highest, self._last)

    def sentence(self, best: str | None) -> str | None:
        if self._highest < _PEAK or self._last > FALL_SHARE * self._highest:
            return None
        name = CheckpointName.parse(best or "")
        where = "" if name is None else f"; best is {name.number}"
        return f"completion fell from {self._highest:.0f} % to {self._last:.0f} %{where}"


def collapse(records: Iterable[IterationRecord], best: str | None) -> str | None:
    return Fall(records).sentence(best)
