"""Decides in the trainer who drives which episodes when workers join and leave.

As long as nobody has joined, each of DR_WORKERS drives the same share and nothing is written.
Later shares are in an object of the bucket, and change with the first iteration that no worker
can have begun before the checkpoint that names their version.
"""

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from statistics import median

from drcli.base.errors import StorageError
from drcli.base.log import get_logger
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.model.training_state import MISSED_S, Member, MemberReader, read_shares_record
from drcli.records.job import Shares, SharesRecord, WorkerShare
from drcli.train.episode_share import Share

# Divides the episodes of an iteration by the speeds of workers.


EQUAL_WITHIN = 1.5
"""Within this factor shares are equal: how long episodes last differs too, and equal shares let a
training be repeated exactly.
"""


def divide(episodes: int, speeds: Sequence[float | None], most: int) -> list[int]:
    """Counts with the sum `episodes`; 0 for less than half an episode.

    `speeds`: None for a worker that has not driven yet, which counts as the median. `most` is
    raised where it is too few.
    """
    if not speeds:
        return []
    most = max(most, -(-episodes // len(speeds)))
    known = [speed for speed in speeds if speed]
    usual = median(known) if known else 1.0
    weights = [speed or usual for speed in speeds]
    if max(weights) <= EQUAL_WITHIN * min(weights):
        weights = [1.0] * len(weights)
    counts = [0] * len(weights)
    left = episodes
    while left:
        # Those that are full drop out, and the others share what is left.
        open_ones = [at for at, count in enumerate(counts) if count < most]
        total = sum(weights[at] for at in open_ones)
        quotas = {at: left * weights[at] / total for at in open_ones}
        whole = {at: min(int(quotas[at]), most - counts[at]) for at in open_ones}
        for at, count in whole.items():
            counts[at] += count
        if not any(whole.values()):
            # By the largest fraction; of equal ones, the first.
            by_fraction = sorted(open_ones, key=lambda at: (-quotas[at], at))
            for at in by_fraction[:left]:
                counts[at] += 1
        left = episodes - sum(counts)
    return counts


_logger = get_logger(__name__)

POLL_S, FRUGAL_LOOK_S, STARTING_LOOK_S = 5.0, 10.0, 1.0
"""In any case, where looks cost money, while nobody drives or one is starting."""

KEPT_SHARES = 4
"""A worker may be some checkpoints behind."""

LATE_PAUSE_S, LONGEST_PAUSE_S = 10.0, 600.0
"""After late rollouts; doubles each time."""

PUNCTUAL = 10
"""Then a worker counts as if it had never been late."""

KNOWN_AFTER = 3
"""The first iteration may include compilation."""

MEASURED_S = 2.0
"""Shortest drive from which a late worker is judged."""

TRIED_AGAIN_S = 60.0
"""Then a worker that is too slow for a share gets one episode."""

NEWEST_WEIGHT = 0.2


@dataclass
class _Punctuality:
    pause_s: float = LATE_PAUSE_S
    excluded_until_s: float = 0.0
    excluded_at: int = -1
    in_time: int = 0


class EpisodeAllocator:
    """The shares of a training; the trainer is their only writer.

    `equal`: shares stay so. `frugal`: each look costs money. `failure` is that of the last
    joined worker that failed.
    """

    def __init__(
        self,
        model: ModelStore,
        session: str,
        workers: int,
        lag: int = 0,
        *,
        equal: bool = False,
        frugal: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._model = model
        self._session = session
        self._workers = workers
        self._lag = lag
        self._equal = equal
        self._frugal = frugal
        self._clock = clock
        self._reader = MemberReader(model, session, clock)
        self._looker = ThreadPoolExecutor(1, thread_name_prefix="members")
        self._look: Future[dict[str, Member]] | None = None
        self._looked_s = float("-inf")
        self._members: dict[str, Member] = {}
        self._has_looked = False
        self.failure = ""
        self.begin_stage(1, 0)
        self._speeds: dict[int, float] = {}
        self._measured: dict[int, int] = {}
        self._shared_s: dict[int, float] = {}
        self._punctuality: dict[str, _Punctuality] = {}
        self._next_numbers: dict[int, int] = {}
        found = read_shares_record(model)
        own = found is not None and found.session == session
        # After the trainer's process was started again, the workers still drive these shares.
        self._record = found if found is not None and own else SharesRecord(session)
        self._written = self._record

    def begin_stage(self, episodes: int, numbered: int, first: int = 0) -> None:
        """`numbered` is as for `Share`; nobody drives iteration `first` ahead."""
        self._first = first
        workers = max(1, self._workers)
        self._fixed = [Share(k, workers, episodes, numbered) for k in range(self._workers)]
        self._episodes = episodes
        self._most = Share(0, workers, episodes, numbered).most

    def close(self) -> None:
        self._looker.shutdown(wait=False, cancel_futures=True)

    def at(self, iteration: int) -> tuple[WorkerShare, ...]:
        shares = self._record.at(iteration)
        if shares is not None:
            return shares.workers
        return tuple(self._own_share(k, iteration) for k in range(self._workers))

    def version_for(self, checkpoint: int) -> int | None:
        """Decide who drives from this checkpoint on; None: as ever.

        Raises:
            StorageError: The shares cannot be written.
        """
        self.look()
        chosen = self._chosen(checkpoint)
        if not self._record.newest and not any(share.member for share in chosen):
            self._write()
            return None
        ahead = self._lag if checkpoint > self._first else 0
        self._change(checkpoint, checkpoint + ahead, chosen)
        return self._record.newest[-1].version

    def reassign(self, checkpoint: int) -> bool:
        """Let others drive the open iteration if all that should have left.

        Raises:
            StorageError: The shares cannot be written.
        """
        self.look()
        self._write()
        if self._workers or any(self._is_alive(share.member) for share in self.at(checkpoint)):
            return False
        chosen = self._chosen(checkpoint)
        if not chosen:
            return False
        self._change(checkpoint, checkpoint, chosen)
        return True

    @property
    def nobody(self) -> bool:
        return not self._workers and not any(each.is_alive for each in self._members.values())

    def is_hopeless(
        self, share: WorkerShare, iteration: int, steps: float, within_s: float
    ) -> bool:
        """Whether nobody should wait for a joined worker.

        It has left, is silent, was started again, or is too slow.
        """
        self.look(often=True)
        member = self._members.get(share.member)
        if member is None:
            return self._has_looked
        if member.silent_s >= MISSED_S or not member.record.ready:
            return True
        speed = self._reported_speed(member, iteration)
        return speed is not None and steps > speed * within_s

    def note(self, speeds: Mapping[int, float], late: Collection[int], checkpoint: int) -> None:
        for worker, speed in self._with_growth(speeds, checkpoint).items():
            times = self._measured[worker] = self._measured.get(worker, 0) + 1
            before = self._speeds[worker] if times > 2 else speed
            if speed > EQUAL_WITHIN * before:
                before = speed  # it is no longer slowed down
            self._speeds[worker] = before + NEWEST_WEIGHT * (speed - before)
        for share in self.at(checkpoint):
            if not share.member:
                continue
            known = self._punctuality.setdefault(share.member, _Punctuality())
            if share.worker in speeds:
                known.in_time += 1
                if known.in_time >= PUNCTUAL:
                    known.pause_s = LATE_PAUSE_S
            elif share.worker in late:
                known.in_time = 0
                known.excluded_until_s = self._clock() + known.pause_s
                known.excluded_at = checkpoint + 1
                alive = self._is_alive(share.member)
                if alive:
                    self._note_slow(share, checkpoint)
                _logger.warning(
                    "Simulation worker %d, which has joined, %s; the others drive its share%s.",
                    share.worker,
                    "is late" if alive else "is gone",
                    f" for at least {known.pause_s:.0f} s" if alive else "",
                )
                known.pause_s = min(2.0 * known.pause_s, LONGEST_PAUSE_S)

    def _with_growth(self, speeds: Mapping[int, float], checkpoint: int) -> dict[int, float]:
        """Twice the mean for a worker that was ready long before the others.

        A small part takes longer for each step; its share would grow only slowly.
        """
        counts = {share.worker: share.count for share in self.at(checkpoint)}
        took = {k: counts[k] / speed for k, speed in speeds.items() if speed and k in counts}
        grown = dict(speeds)
        for worker, its in took.items():
            if worker in self._speeds and its * EQUAL_WITHIN < max(took.values()):
                twice = 2.0 * self._speeds[worker]
                grown[worker] = max(grown[worker], min(twice, median(speeds.values())))
        return grown

    def _note_slow(self, share: WorkerShare, iteration: int) -> None:
        """A share that it can drive in time, by what it reports."""
        member = self._members.get(share.member)
        speed = None if member is None else self._reported_speed(member, iteration)
        if speed is None:
            return
        times = self._measured[share.worker] = self._measured.get(share.worker, 0) + 1
        if times > 1 and speed < self._speeds.get(share.worker, math.inf):
            self._speeds[share.worker] = speed
            self._measured[share.worker] = max(KNOWN_AFTER, times)

    @staticmethod
    def _reported_speed(member: Member, iteration: int) -> float | None:
        record = member.record
        known = record.drives == iteration and record.drive_s >= MEASURED_S
        return record.steps / record.drive_s if known else None

    def look(self, *, wait: bool = False, often: bool = False) -> None:
        """Look for workers that have joined or left, in a thread, if it is time.

        What it finds counts from the next call on; with `wait`, from this one.
        """
        self._begin_look(often=often)
        if self._look is not None and (wait or self._look.done()):
            try:
                self._take(self._look.result())
            except StorageError as error:
                _logger.warning("Cannot see which workers have joined: %s", error)
            self._look = None

    def _begin_look(self, *, often: bool) -> None:
        usual_s = FRUGAL_LOOK_S if self._frugal else POLL_S
        newest = self._record.newest[-1].workers if self._record.newest else ()
        driving = {share.member for share in newest}
        drives = self._workers or any(map(self._is_alive, driving))
        starting = any(each.is_alive and not each.record.ready for each in self._members.values())
        every_s = usual_s if drives and not starting and not often else STARTING_LOOK_S
        if self._look is None and self._clock() >= self._looked_s + every_s:
            self._looked_s = self._clock()
            self._look = self._looker.submit(self._reader.read)

    def _take(self, members: dict[str, Member]) -> None:
        for name in [name for name, member in members.items() if member.record.failure]:
            record = members.pop(name).record
            self.failure = f"{record.host}: {record.failure}"
            _logger.warning("%s has failed on %s", name, self.failure)
            self._model.bucket.delete([keys.member(self._model.prefix, name)])
        for name in members.keys() - self._members.keys():
            _logger.info("%s has joined as %s.", members[name].record.host, name)
        for name in self._members.keys() - members.keys():
            _logger.info("%s has left.", name)
        self._members = members
        self._has_looked = True
        driving = {share.member for shares in self._record.newest[-1:] for share in shares.workers}
        numbers = {
            name: number
            for name, number in self._record.numbers.items()
            if name in members or name in driving
        }
        for name in sorted(members.keys() - numbers.keys()):
            taken = set(numbers.values())
            numbers[name] = min(set(range(self._workers, self._workers + len(taken) + 1)) - taken)
        self._record = replace(self._record, numbers=numbers)

    def _is_alive(self, member: str) -> bool:
        return not member or (member in self._members and self._members[member].is_alive)

    def _chosen(self, checkpoint: int) -> list[WorkerShare]:
        ready = {
            name: number
            for name, number in self._record.numbers.items()
            if self._is_alive(name) and name in self._members and self._members[name].record.ready
        }
        punctual = {name: n for name, n in ready.items() if not self._is_excluded(name)}
        if not punctual and not self._workers:
            punctual = ready  # better late than nobody
        joined = sorted((number, name) for name, number in punctual.items())
        workers = [(k, "") for k in range(self._workers)] + joined
        if self._equal or not joined:
            speeds: list[float | None] = [None] * len(workers)
        else:
            known = {k for k, times in self._measured.items() if times >= KNOWN_AFTER}
            speeds = [self._speeds[k] if k in known else None for k, _ in workers]
        counts = divide(self._episodes, speeds, self._most)
        self._try_slow_ones([number for number, _ in workers], counts)
        if self._workers and not counts[0]:  # worker 0 also evaluates
            counts[counts.index(max(counts))] -= 1
            counts[0] = 1
        return [
            WorkerShare(number, name, 0, count)
            for (number, name), count in zip(workers, counts, strict=True)
            if count
        ]

    def _try_slow_ones(self, workers: list[int], counts: list[int]) -> None:
        now_s = self._clock()
        for at, worker in enumerate(workers):
            waited_s = now_s - self._shared_s.get(worker, now_s)
            if not counts[at] and waited_s >= TRIED_AGAIN_S and max(counts) > 1:
                counts[counts.index(max(counts))] -= 1
                counts[at] = 1
            if counts[at]:
                self._shared_s[worker] = now_s

    def _is_excluded(self, member: str) -> bool:
        known = self._punctuality.get(member)
        if known is None:
            return False
        behind = self._members[member].record.checkpoint < known.excluded_at
        return behind or self._clock() < known.excluded_until_s

    def _change(self, checkpoint: int, iteration: int, chosen: list[WorkerShare]) -> None:
        newest = self._record.newest
        kept = [shares for shares in newest if shares.checkpoint <= checkpoint]  # after a rollback
        same = bool(kept) and [_who(s) for s in kept[-1].workers] == [_who(s) for s in chosen]
        if same and kept[-1].iteration <= iteration:
            self._record = replace(self._record, newest=tuple(kept))
            self._write()
            return
        for share in newest[-1].workers if newest else self.at(iteration):
            ahead = max(0, iteration - newest[-1].iteration) if newest else 0
            number = share.first + ahead * share.count
            self._next_numbers[share.worker] = max(number, self._next_numbers.get(share.worker, 0))
        shares = Shares(
            newest[-1].version + 1 if newest else 1,
            checkpoint,
            iteration,
            tuple(replace(s, first=self._next_numbers.get(s.worker, 0)) for s in chosen),
        )
        self._record = replace(self._record, newest=(*kept, shares)[-KEPT_SHARES - self._lag :])
        self._write()
        sentence = ", ".join(f"worker {share.worker}: {share.count}" for share in chosen)
        _logger.info("From iteration %d on, episodes are shared: %s.", iteration, sentence)

    def _own_share(self, worker: int, iteration: int) -> WorkerShare:
        numbers = self._fixed[worker].numbers(iteration)
        return WorkerShare(worker, "", numbers.start, len(numbers))

    def _write(self) -> None:
        if self._record != self._written:
            self._model.bucket.put(keys.shares(self._model.prefix), self._record.encode())
            self._written = self._record


def _who(share: WorkerShare) -> tuple[int, str, int]:
    return share.worker, share.member, share.count
