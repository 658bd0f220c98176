"""Where all cars of a worker are and how they do, for the live view."""

import math
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from time import time as unix_s

from drcli.config.run_config import DriveConfig
from drcli.config.value_types import shell_color
from drcli.live.live_record import (
    FinishedEpisode,
    LiveCar,
    LiveObject,
    LiveRacer,
    LiveScene,
    ShownCar,
)
from drcli.live.step_snapshot import Rider, StepSnapshot, with_policy
from drcli.records.trace import VIOLATIONS, Episode, Phase, Row
from drsim.car.actions import DiscreteActions
from drsim.episode.episode_rules import Status

# Rewards of running episodes and the newest laps, for the live view.


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


class LiveEpisodes:
    """For any thread.

    Episodes are counted when somebody asks: the driving loop would lose 0.2 % of its time.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[int, _Open] = {}
        self._ended: deque[tuple[Episode, int, Drive, float]] = deque()
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
            self._ended.append((episode, racer, drive, unix_s()))
            if len(self._ended) > REMEMBERED:
                self._open.pop(id(self._ended.popleft()[0].rows), None)

    def forget(self) -> None:
        """Nobody will end the running episodes."""
        with self._lock:
            if self._open:
                self._settle()
            self._open.clear()

    def _settle(self) -> None:
        while self._ended:
            episode, racer, drive, ended_s = self._ended.popleft()
            found = self._open.pop(id(episode.rows), None) or _Open(episode.rows)
            who = episode.number, episode.phase, racer
            self._count(found, len(episode.rows), who, drive, ended_s)
            if found.began_row < found.counted:
                self._finish(found, who, drive, ended_s)

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


BLIND = "A teacher drives now: it sees the track, and there are no camera pictures in this phase."
STATUS_WORDS = [status.label for status in Status]


@dataclass(frozen=True)
class LiveFacts:
    """What does not change from step to step; `iteration` is None in an evaluation."""

    race_type: str = "TIME_TRIAL"
    racers: list[LiveRacer] = field(default_factory=list)
    iteration: int | None = None
    checkpoint: str = ""
    hint: str = ""

    def drive(self, world: str) -> Drive:
        return Drive(world, self.iteration, self.checkpoint)

    @property
    def colors(self) -> list[tuple[float, float, float]]:
        return [shell_color(racer.color) for racer in self.racers]


def live_racer(model: str, color: str) -> LiveRacer:
    return LiveRacer(model, color, tuple(round(share) for share in shell_color(color)))


def facts_of(race: DriveConfig, models: Sequence[str], opponent_color: str = "") -> LiveFacts:
    colors = [race.car_color, *([opponent_color] * (len(models) - 1))]
    racers = [live_racer(*each) for each in zip(models, colors, strict=True)]
    return LiveFacts(race.race_type, racers)


def chosen_rider(moment: StepSnapshot, wanted: int | None, before: Rider | None) -> Rider | None:
    """`wanted` None: the one that has come furthest.

    The car shown `before` stays until its episode is over: a view that jumps shows nothing.
    """
    result = moment.result
    running = [rider for rider in moment.riders if not result.done[rider.car]]
    riders = {rider.car: rider for rider in running or moment.riders}
    if wanted is not None:
        return next((rider for rider in moment.riders if rider.car == wanted), None)
    if before is not None and before.car in riders:
        same = riders[before.car]
        if same.rows is before.rows:
            return same
    return max(riders.values(), key=lambda rider: result.progress.item(rider.car), default=None)


def scene_of(
    moment: StepSnapshot, facts: LiveFacts, episodes: LiveEpisodes, rider: Rider | None
) -> LiveScene:
    cars = [_car(moment, each, facts, episodes) for each in moment.riders]
    shown = rider or next(iter(moment.riders), None)
    actions: list[list[float]] = []
    if moment.looks and isinstance(found := moment.looks[0].actions, DiscreteActions):
        actions = [[float(angle), float(speed)] for angle, speed in found.choices]
    return LiveScene(
        world="" if shown is None else shown.track.name,
        reverse=shown is not None and shown.track.reverse,
        race_type=facts.race_type,
        iteration=facts.iteration,
        checkpoint=facts.checkpoint,
        racers=facts.racers,
        actions=actions,
        cars=cars,
        shown=None if rider is None else shown_car(moment, rider),
        finished=episodes.finished,
    )


def shown_car(moment: StepSnapshot, rider: Rider) -> ShownCar:
    objects = [
        LiveObject(shape.name, _number(x, 3), _number(y, 3), _number(math.degrees(yaw), 1))
        for shape, (x, y, yaw) in zip(
            moment.shapes, moment.objects[rider.car].tolist(), strict=True
        )
    ]
    shown = ShownCar(rider.car, objects)
    look = moment.look_of(rider.car)
    return shown if look is None else with_policy(shown, *look, moment.calls)


def _racer_of(rider: Rider, facts: LiveFacts) -> int:
    """A teacher and its student are the same one."""
    return min(rider.racer, max(0, len(facts.racers) - 1))


def _car(moment: StepSnapshot, rider: Rider, facts: LiveFacts, episodes: LiveEpisodes) -> LiveCar:
    result, car = moment.result, rider.car
    total = episodes.follow(rider, facts.drive(rider.track.name))
    return LiveCar(
        car=car,
        racer=_racer_of(rider, facts),
        episode=rider.episode,
        phase=rider.phase,
        reverse=rider.reverse,
        x=_number(result.x.item(car), 3),
        y=_number(result.y.item(car), 3),
        yaw_deg=_number(result.yaw_deg.item(car), 1),
        speed_mps=_number(moment.speeds_mps.item(car), 3),
        asked_mps=_number(moment.asked_mps.item(car), 3),
        steering_deg=_number(moment.steering_deg.item(car), 2),
        progress=_number(result.progress.item(car), 2),
        reward=_number(result.reward.item(car), 4),
        total=_number(total, 4),
        status=STATUS_WORDS[result.status.item(car)],
        steps=result.steps.item(car),
        lap_s=_number(result.lap_time_s.item(car), 3),
        laps=result.laps.item(car),
        resets=result.resets.item(car),
        world=rider.track.name,
    )


def _number(value: float, digits: int) -> float:
    """0 for what JSON does not know, as of a car whose physics failed."""
    return round(value, digits) if math.isfinite(value) else 0.0
