"""Rewards of running episodes and the newest laps, for the live view."""

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from time import time as unix_s

from drcli.exchange.live_record import FinishedEpisode
from drcli.exchange.trace import VIOLATIONS, Episode, Phase, Row
from drcli.workers.live_moment import Rider

REMEMBERED = 24
COMPLETE = 100.0

Who = tuple[int, Phase, int]


@dataclass
class _Open:
    rows: Sequence[Row]
    counted: int = 0
    total: float = 0.0
    began_row: int = 0
    began_s: float = 0.0
    began_total: float = 0.0
    lap: int = 1
    resets: int = 0


@dataclass(frozen=True)
class Drive:
    world: str
    iteration: int | None
    checkpoint: str


@dataclass(frozen=True)
class _Ended:
    episode: Episode
    racer: int
    drive: Drive
    ended_s: float


class LiveEpisodes:
    """For any thread.

    Episodes are counted when somebody asks: the driving loop would lose 0.2 % of its time.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[int, _Open] = {}
        self._ended: deque[_Ended] = deque()
        self._finished: deque[FinishedEpisode] = deque(maxlen=REMEMBERED)
        self._serial = 0

    @property
    def finished(self) -> list[FinishedEpisode]:
        with self._lock:
            self._settle()
            return list(self._finished)

    def follow(self, rider: Rider, drive: Drive) -> float:
        """Returns the reward so far; complete laps are remembered."""
        rows = rider.rows
        if rows[-1].done:  # `end` counts it, or has done so already
            return sum(row.reward for row in rows[: rider.steps])
        with self._lock:
            self._settle()
            # By identity: numbers of episodes begin anew. The rows are kept, so is their identity.
            found = self._open.setdefault(id(rows), _Open(rows))
            who = rider.episode, rider.phase, rider.racer
            self._count(found, rider.steps, who, drive, unix_s())
            return found.total

    def end(self, episode: Episode, racer: int, drive: Drive) -> None:
        if not episode.rows:
            return
        with self._lock:
            self._ended.append(_Ended(episode, racer, drive, unix_s()))
            if len(self._ended) > REMEMBERED:
                self._open.pop(id(self._ended.popleft().episode.rows), None)

    def forget(self) -> None:
        """Nobody will end the running episodes."""
        with self._lock:
            if self._open:
                self._settle()
            self._open.clear()

    def _settle(self) -> None:
        while self._ended:
            ended = self._ended.popleft()
            rows = ended.episode.rows
            found = self._open.pop(id(rows), None) or _Open(rows)
            who = ended.episode.number, ended.episode.phase, ended.racer
            self._count(found, len(rows), who, ended.drive, ended.ended_s)
            if found.began_row < found.counted:
                self._finish(found, who, ended.drive, ended.ended_s)

    def _count(self, found: _Open, rows: int, who: Who, drive: Drive, ended_s: float) -> None:
        while found.counted < rows:
            row = found.rows[found.counted]
            found.counted += 1
            found.total += row.reward
            found.resets += row.status in VIOLATIONS and not row.done
            if row.progress >= COMPLETE:
                self._finish(found, who, drive, ended_s)

    def _finish(self, found: _Open, who: Who, drive: Drive, ended_s: float) -> None:
        number, phase, racer = who
        row = found.rows[found.counted - 1]
        self._serial += 1
        self._finished.append(
            FinishedEpisode(
                serial=self._serial,
                episode=number,
                phase=phase,
                racer=racer,
                world=drive.world,
                iteration=drive.iteration,
                checkpoint=drive.checkpoint,
                status=row.status,
                lap=found.lap,
                progress=round(row.progress, 2),
                time_s=round(row.time_s - found.began_s, 3),
                reward=round(found.total - found.began_total, 4),
                steps=found.counted - found.began_row - (found.lap == 1),
                ended_s=round(ended_s, 3),
                resets=found.resets,
            )
        )
        found.began_row, found.began_s = found.counted, row.time_s
        found.began_total = found.total
        found.lap += 1
        found.resets = 0
