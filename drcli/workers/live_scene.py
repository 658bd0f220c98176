"""Where all cars of a worker are and how they do, for the live view."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from drcli.config.run_config import RaceConfig
from drcli.config.shell_colors import shell_color
from drcli.exchange.live_record import LiveCar, LiveObject, LiveRacer, LiveScene, ShownCar
from drcli.workers.live_episodes import Drive, LiveEpisodes
from drcli.workers.live_moment import Moment, Rider
from drcli.workers.live_policy import with_policy
from drsim.car.actions import DiscreteActions
from drsim.episode.episode_rules import Status

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


def facts_of(race: RaceConfig, models: Sequence[str], opponent_color: str = "") -> LiveFacts:
    colors = [race.car_color, *([opponent_color] * (len(models) - 1))]
    racers = [live_racer(*each) for each in zip(models, colors, strict=True)]
    return LiveFacts(race.race_type, racers)


def chosen_rider(moment: Moment, wanted: int | None, before: Rider | None) -> Rider | None:
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
    moment: Moment, facts: LiveFacts, episodes: LiveEpisodes, rider: Rider | None
) -> LiveScene:
    drive = facts.drive(moment.track.name)
    cars = [_car(moment, each, facts, episodes, drive) for each in moment.riders]
    actions: list[list[float]] = []
    if moment.looks and isinstance(found := moment.looks[0].actions, DiscreteActions):
        actions = [[float(angle), float(speed)] for angle, speed in found.choices]
    return LiveScene(
        world=moment.track.name,
        reverse=moment.track.reverse,
        race_type=facts.race_type,
        iteration=facts.iteration,
        checkpoint=facts.checkpoint,
        racers=facts.racers,
        actions=actions,
        cars=cars,
        shown=None if rider is None else shown_car(moment, rider),
        finished=episodes.finished,
    )


def shown_car(moment: Moment, rider: Rider) -> ShownCar:
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


def _car(
    moment: Moment, rider: Rider, facts: LiveFacts, episodes: LiveEpisodes, drive: Drive
) -> LiveCar:
    result, car = moment.result, rider.car
    total = episodes.follow(rider, drive)
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
    )


def _number(value: float, digits: int) -> float:
    """0 for what JSON does not know, as of a car whose physics failed."""
    return round(value, digits) if math.isfinite(value) else 0.0
