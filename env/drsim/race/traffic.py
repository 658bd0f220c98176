"""What each car meets on the track: obstacles, bots and opponents."""

import math
from dataclasses import dataclass

import numpy as np

from drsim.arrays import Bools, Floats, Ints, Seeds
from drsim.car.car import REFERENCE_POINT_AHEAD_M
from drsim.jit import kernel
from drsim.race.bots import Bots, LanePaths
from drsim.race.objects import Objects
from drsim.race.race import BotRules, ObstacleRules, Race
from drsim.race.solids import SHAPES, Shape
from drsim.track.track import CENTER, INNER, OUTER, Track
from drsim.track.ways import Ways

# Whether rectangles on the floor overlap.


Rectangles = tuple[Floats, Floats, Floats]
"""Centres in metres, shape (n, 2) or (n, k, 2); directions, (n,) or (n, k); lengths and widths,
(2,) or (k, 2).
"""


@kernel
def overlaps(one: Rectangles, others: Rectangles) -> Bools:
    """Compare n rectangles with k others each; touching is not overlapping. Shape (n, k).

    Two are apart when one of their four axes separates their shadows on it.
    """
    one_xy, one_yaw_rad, one_size_m = one
    other_xy, other_yaw_rad, other_size_m = others
    out: Bools = np.empty(other_yaw_rad.shape, np.bool_)
    length_m, width_m = 0.5 * one_size_m[0], 0.5 * one_size_m[1]
    for i in range(out.shape[0]):
        yaw_rad = one_yaw_rad[i]
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        for k in range(out.shape[1]):
            half_m, across_m = 0.5 * other_size_m[k, 0], 0.5 * other_size_m[k, 1]
            dx, dy = other_xy[i, k, 0] - one_xy[i, 0], other_xy[i, k, 1] - one_xy[i, 1]
            reach_m = math.hypot(length_m, width_m) + math.hypot(half_m, across_m)
            # Written so that a distance that is NaN overlaps nothing.
            if not dx * dx + dy * dy < reach_m * reach_m:
                out[i, k] = False
                continue
            other_rad = other_yaw_rad[i, k]
            c, s = abs(math.cos(other_rad - yaw_rad)), abs(math.sin(other_rad - yaw_rad))
            other_cos, other_sin = math.cos(other_rad), math.sin(other_rad)
            out[i, k] = (
                abs(cos * dx + sin * dy) < length_m + half_m * c + across_m * s
                and abs(cos * dy - sin * dx) < width_m + half_m * s + across_m * c
                and abs(other_cos * dx + other_sin * dy) < half_m + length_m * c + width_m * s
                and abs(other_cos * dy - other_sin * dx) < across_m + length_m * s + width_m * c
            )
    return out


# Places along the track for objects that keep a distance.


LAST_PLACE_M = 1.0
"""Before the end of the lap. Source: the reference simulator."""

FREE_START_M = 1.0
MOST_OBJECTS = 100


def check_room(track: Track, count: int, gap_m: float) -> None:
    """Raise ValueError if so many objects do not fit on a track."""
    fit = most_that_fit(track, gap_m)
    if count > fit:
        raise ValueError(
            f"{count} objects at least {gap_m:g} m apart are too many for {track.name}, which is "
            f"{track.length_m:.1f} m long: {fit} would fit."
        )


def most_that_fit(track: Track, gap_m: float) -> int:
    """A single one always can."""
    room_m = track.length_m - LAST_PLACE_M
    if room_m >= MOST_OBJECTS * gap_m:
        return MOST_OBJECTS
    return max(int(room_m / gap_m + 1e-9), 1)


def even_places(track: Track, count: int, gap_m: float) -> Floats:
    """Metres along the lap, from the gap itself to a metre before the end. Shape (count,).

    Source: the reference simulator, but for its gap, which was a percentage.
    """
    last_m = max(track.length_m - LAST_PLACE_M, 0.0)
    return np.linspace(min(gap_m, last_m), last_m, count)


def drawn_places(
    track: Track, count: int, gap_m: float, start_m: float, random: np.random.Generator
) -> Floats:
    """Metres along the lap, drawn evenly among all places that keep the gap, also across its end.

    In driving order from the start, which stays free; `count` objects must fit.
    """
    length_m = track.length_m
    taken_m = max(count - 1, 0) * gap_m
    if track.closed:
        free_m = min(max(FREE_START_M, gap_m / 2), (length_m - taken_m) / 2)
        room_m = length_m - taken_m - 2 * free_m
        first_m = start_m + free_m
    else:
        first_m = min(FREE_START_M, length_m - taken_m)
        room_m = max(length_m - LAST_PLACE_M - taken_m - first_m, 0.0)
    places_m = first_m + np.sort(random.uniform(0.0, room_m, count)) + gap_m * np.arange(count)
    return places_m % length_m if track.closed else np.minimum(places_m, length_m)


NEAR_M = 1.0
"""Changes where a car starts or is put back. Source: the reference simulator."""

BLOCKS_M = 0.5
"""From an obstacle on its lane."""

OPPONENT_GAP_M = 0.75
"""Source: the reference simulator."""


@dataclass(frozen=True)
class Contacts:
    """Who ran into what in a step; `other` is its index, -1 for none. Shape (n,)."""

    crashed: Bools
    other: Ints
    other_stands: Bools


class Traffic:
    """The objects of n cars, k for each, in the order of the reference: opponent, obstacles, bots.

    Distances are along the centre line, in the car's driving direction.
    """

    def __init__(self, ways: Ways, race: Race) -> None:
        """ValueError if objects do not fit on a track."""
        num_cars = len(ways.way)
        self.ways = ways
        self._race = race
        self._opponents = race.racers - 1
        self._obstacles = 0
        if race.obstacles is not None:
            self._obstacles = len(race.obstacles.positions) or race.obstacles.count
        number_of_bots = race.bots.count if race.bots is not None else 0
        for track in ways.tracks[::2]:
            if race.obstacles is not None and not race.obstacles.positions:
                check_room(track, race.obstacles.count, race.obstacles.min_gap_m)
            if race.bots is not None:
                check_room(track, race.bots.count, race.bots.min_gap_m)
        self._standing = slice(self._opponents, self._opponents + self._obstacles)
        self._driving = slice(self._opponents + self._obstacles, None)
        kind = race.obstacles.kind if race.obstacles is not None else "box_obstacle"
        self.shapes: tuple[Shape, ...] = (
            (SHAPES["race_car"],) * self._opponents
            + (SHAPES[kind],) * self._obstacles
            + (SHAPES["bot_car"],) * number_of_bots
        )
        count = len(self.shapes)
        box = race.obstacles is not None and race.obstacles.kind != "bot_car"
        tells_heading = [not (box and shape.name == kind) for shape in self.shapes]
        self._objects = Objects(
            xy=np.zeros((num_cars, count, 2)),
            yaw_rad=np.zeros((num_cars, count)),
            footprint_m=np.array([each.footprint_m for each in self.shapes]).reshape(count, 2),
            distance_m=np.zeros((num_cars, count)),
            from_center_m=np.zeros((num_cars, count)),
            left_of_center=np.zeros((num_cars, count), np.bool_),
            speed_mps=np.zeros(count),
            tells_heading=np.array(tells_heading, np.bool_),
        )
        self.xy, self.yaw_rad, self._footprint_m, self.distance_m, *_ = self._objects
        self.track_width_m: Floats = np.zeros((num_cars, count))
        self._lane: Ints = np.full((num_cars, count), INNER)
        self._start_m: Floats = np.zeros(num_cars)
        self._put_back_at: Ints = np.zeros((num_cars, count), np.int64)
        self._bots = Bots(num_cars, race.bots) if race.bots is not None else None
        self._paths = LanePaths(ways.tracks) if race.bots is not None else None
        if race.bots is not None:
            self._objects.speed_mps[self._driving] = race.bots.speed_mps

    def begin(self, cars: Ints, start_fraction: Floats, seeds: Seeds) -> None:
        """Place the objects of new episodes of some cars."""
        self._put_back_at[cars] = 0
        columns = (cars.tolist(), start_fraction.tolist(), seeds.tolist())
        for car, fraction, seed in zip(*columns, strict=True):
            track = self.ways.of(car)
            self._start_m[car] = fraction * track.length_m
            random = np.random.Generator(np.random.Philox(key=np.array([seed, _STREAM], np.uint64)))
            if self._race.obstacles is not None and self._obstacles:
                self._place_obstacles(self._race.obstacles, car, track, random)
            if self._bots is not None:
                places_m, lanes = self._places(car, track, self._bots.rules, random)
                self._bots.begin(car, places_m, lanes - INNER, random)
        self._move_bots()

    def start_lane(self, cars: Ints) -> Ints:
        """The centre line, or the lane away from an object; two racers start on different lanes."""
        if self._opponents:
            return np.where(cars % 2 == 0, OUTER, INNER)
        apart_m = np.abs(self._gap_m(cars, self.distance_m[cars], self._start_m[cars][:, None]))
        on_inner_m, on_outer_m = _nearest_on(self._lane[cars], apart_m)
        away = np.where(on_inner_m <= on_outer_m, OUTER, INNER)
        return np.where(np.minimum(on_inner_m, on_outer_m) < NEAR_M, away, CENTER)

    def start_gap_m(self, cars: Ints) -> Floats:
        """How far behind the start each car starts."""
        return np.where(self._opponents & (cars % 2), OPPONENT_GAP_M, 0.0)

    def advance(self, moving: Bools) -> None:
        if self._bots is not None:
            self._bots.advance(moving)
        self._move_bots()

    def follow(self, origin_xy: Floats, yaw_rad: Floats) -> None:
        if not self._opponents:
            return
        other = np.arange(len(origin_xy)) ^ 1
        self.xy[:, 0] = origin_xy[other]
        self.yaw_rad[:, 0] = yaw_rad[other]
        self._find(slice(0, 1))

    def contacts(
        self, active: Bools, origin_xy: Floats, yaw_rad: Floats, along_m: Floats
    ) -> Contacts:
        """Find out which cars ran into what, and stop bots that ran into a racer.

        With a bot or an opponent, only the car behind has crashed. Cars that are not `active`
        touch nothing.
        """
        touching = overlaps(
            (origin_xy, yaw_rad, np.array(SHAPES["race_car"].footprint_m)),
            (self.xy, self.yaw_rad, self._footprint_m),
        )
        touching &= active[:, None]
        if self._opponents:
            touching[:, 0] &= active[np.arange(len(active)) ^ 1]
        if not touching.any():
            nobody = np.zeros(len(active), np.bool_)
            return Contacts(nobody, np.full(len(active), -1), nobody)
        origin_m = along_m - REFERENCE_POINT_AHEAD_M
        there_m = self.distance_m.copy()
        if self._opponents:
            # The opponent's own count, so that exactly one of two is behind. If they drive towards
            # each other, both meet what is ahead of them.
            opponent = np.arange(len(active)) ^ 1
            same_way = self.ways.way == self.ways.way[opponent]
            there_m[same_way, 0] = origin_m[opponent[same_way]]
        behind = self._gap_m(np.arange(len(active)), there_m, origin_m[:, None]) > 0
        behind[:, self._standing] = True
        into = touching & behind
        if self._bots is not None:
            self._bots.halt(np.asarray((touching & ~behind)[:, self._driving].any(axis=1)))
        crashed = np.asarray(into.any(axis=1))
        other = np.where(crashed, into.argmax(axis=1), -1)
        stands = (other >= self._standing.start) & (other < self._standing.stop)
        return Contacts(crashed, other, stands)

    def clear_of(self, cars: Ints, fraction: Floats, lanes: Ints) -> tuple[Floats, Ints]:
        """Where cars go on.

        Behind a near obstacle on the other lane, every `mercy`-th time ahead of it.
        """
        rules = self._race.obstacles
        if rules is None or not self._obstacles:
            return fraction, lanes
        fraction, lanes = fraction.copy(), lanes.copy()
        for k, car in enumerate(cars.tolist()):
            length_m = float(self.ways.length_m[car])
            distance_m = self.distance_m[car, self._standing]
            apart_m = np.abs(self._gap_m(car, distance_m, fraction[k] * length_m))
            nearest = int(apart_m.argmin())
            if apart_m[nearest] >= NEAR_M:
                continue
            obstacle = nearest + self._standing.start
            self._put_back_at[car, obstacle] += 1
            merciful = rules.mercy > 0 and self._put_back_at[car, obstacle] % rules.mercy == 0
            aside_m = rules.reset_behind_m if merciful else -rules.reset_behind_m
            place_m = self._wrapped(car, distance_m[nearest] + aside_m)
            fraction[k] = place_m / length_m
            lanes[k] = self._lane_past(car, obstacle, place_m)
        return fraction, lanes

    def objects(self) -> Objects:
        """A live view."""
        return self._objects

    def gap_m(self, cars: Ints, along_m: Floats) -> Floats:
        """How far ahead of cars their objects are, the shorter way; negative behind."""
        return self._gap_m(cars, self.distance_m[cars], along_m[:, None])

    def moving_mps(self, car_speeds_mps: Floats) -> Floats:
        """How fast all objects move now. Shape (n, k)."""
        speeds = np.zeros_like(self.distance_m)
        if self._opponents:
            speeds[:, 0] = car_speeds_mps[np.arange(len(speeds)) ^ 1]
        if self._bots is not None:
            speeds[:, self._driving] = self._bots.moving_mps[:, None]
        return speeds

    def _lane_past(self, car: int, obstacle: int, place_m: float) -> int:
        lane = int(self._lane[car, obstacle])
        apart_m = np.abs(self._gap_m(car, self.distance_m[car, self._standing], place_m))
        on_inner_m, on_outer_m = _nearest_on(self._lane[car, self._standing], apart_m)
        on_m = {INNER: float(on_inner_m), OUTER: float(on_outer_m)}
        opposite = INNER + OUTER - lane
        return lane if (on_m[opposite] < min(BLOCKS_M, on_m[lane])) else opposite

    def _place_obstacles(
        self, rules: ObstacleRules, car: int, track: Track, random: np.random.Generator
    ) -> None:
        if rules.positions:
            places_m = np.array([fraction for fraction, _ in rules.positions]) * track.length_m
            lanes = np.array([OUTER if lane == -1 else INNER for _, lane in rules.positions])
        else:
            places_m, lanes = self._places(car, track, rules, random)
        group = self._standing
        poses = np.where(
            (lanes == INNER)[:, None],
            track.pose_at(places_m, "inner"),
            track.pose_at(places_m, "outer"),
        )
        self.xy[car, group] = poses[:, :2]
        self.yaw_rad[car, group] = poses[:, 2]
        self._lane[car, group] = lanes
        self._locate(car, group, track)

    def _places(
        self,
        car: int,
        track: Track,
        rules: ObstacleRules | BotRules,
        random: np.random.Generator,
    ) -> tuple[Floats, Ints]:
        count, gap_m = rules.count, rules.min_gap_m
        if rules.randomize:
            places_m = drawn_places(track, count, gap_m, float(self._start_m[car]), random)
            return places_m, random.integers(INNER, OUTER + 1, count)
        return even_places(track, count, gap_m), INNER + np.arange(count) % 2

    def _move_bots(self) -> None:
        if self._bots is None or self._paths is None:
            return
        group, places = self._driving, self._bots.places
        self.xy[:, group], self.yaw_rad[:, group] = self._paths.poses(self.ways, places)
        self._lane[:, group] = np.where(places.share > 0.5, OUTER, INNER)
        self._find(group)

    def _find(self, group: slice) -> None:
        for cars, track in self.ways.groups(np.arange(len(self.ways.way))):
            self._locate(cars, group, track)

    def _locate(self, cars: Ints | int, group: slice, track: Track) -> None:
        xy = self.xy[cars, group]
        where = track.locate(xy.reshape(-1, 2))
        shape = xy.shape[:-1]
        for known, found in (
            (self.distance_m, where.distance_m),
            (self.track_width_m, where.track_width_m),
            (self._objects.from_center_m, where.from_center_m),
            (self._objects.left_of_center, where.left_of_center),
        ):
            known[cars, group] = found.reshape(shape)

    def _gap_m(self, cars: Ints | int, there_m: Floats, here_m: Floats | float) -> Floats:
        gap_m: Floats = there_m - here_m
        half_m = self.ways.length_m[cars, None] / 2
        around_m = (gap_m + half_m) % (2 * half_m) - half_m
        return np.where(self.ways.closed[cars, None], around_m, gap_m)

    def _wrapped(self, car: int, distance_m: float) -> float:
        track = self.ways.of(car)
        if track.closed:
            return distance_m % track.length_m
        return min(max(distance_m, 0), track.length_m)


_STREAM = 1 << 32
"""Second half of the key of random numbers; lights and disturbances use others."""


def _nearest_on(lanes: Ints, apart_m: Floats) -> tuple[Floats, Floats]:
    on_inner_m, on_outer_m = (
        np.where(lanes == lane, apart_m, np.inf).min(axis=-1, initial=np.inf)
        for lane in (INNER, OUTER)
    )
    return on_inner_m, on_outer_m
