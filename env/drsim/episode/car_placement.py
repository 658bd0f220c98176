"""Puts cars on the track: where episodes begin and go on, and aside."""

import numpy as np

from drsim.arrays import Bools, Floats, Ints, Seeds
from drsim.car.car import CarBatch
from drsim.episode.episode_rules import EpisodeState, Status
from drsim.episode.placing import Placing, fraction_at
from drsim.episode.start_poses import start_pose
from drsim.race.traffic import Contacts, Traffic
from drsim.track.track import CENTER


class CarPlacement:
    """Places the cars of a simulation, some at a time."""

    def __init__(self, placing: Placing, cars: CarBatch, traffic: Traffic | None) -> None:
        self._placing = placing
        self._cars = cars
        self._traffic = traffic

    def start(
        self,
        cars: Ints,
        fraction: Floats,
        seeds: Seeds,
        offset_m: Floats | None,
        angle_deg: Floats | None,
    ) -> None:
        if self._traffic is None:
            self._cars.place(cars, self._placing.on(cars, fraction))
        else:
            self._traffic.begin(cars, fraction, self._placing.backward[cars], seeds)
            gap = self._traffic.start_gap_m(cars) / self._placing.tracks[0].length_m
            lanes = self._traffic.start_lane(cars)
            self._cars.place(cars, self._placing.on_each(cars, fraction - gap, lanes))
            self._follow()
        if offset_m is not None or angle_deg is not None:
            self._turn_aside(cars, fraction, offset_m, angle_deg)

    def put_back(
        self,
        cars: Ints,
        state: EpisodeState,
        status: Ints,
        came_from: Floats,
        contacts: Contacts | None,
    ) -> None:
        """Place cars whose violation is forgiven.

        After a crash into another car, where it is; else where it came from, on the nearer lane,
        clear of obstacles.
        """
        stays = np.zeros(len(cars), np.bool_)
        progress = state.previous_progress[cars]
        if contacts is not None:
            into = status[cars] == Status.CRASHED
            stays = into & ~contacts.other_stands[cars]
            progress = np.where(into, state.progress[cars], progress)
        fraction = fraction_at(progress, state.start_fraction[cars])
        lanes = self._placing.nearer_lane(cars, fraction, came_from[cars])
        if self._traffic is not None:
            moved: Bools = ~stays
            fraction[moved], lanes[moved] = self._traffic.clear_of(
                cars[moved], fraction[moved], lanes[moved]
            )
        poses = self._placing.on_each(cars, fraction, lanes)
        self._cars.place(cars, np.where(stays[:, None], self._poses(cars), poses))
        self._follow()

    def move_aside(self, cars: Ints, fraction: Floats) -> None:
        self._cars.place(cars, self._placing.aside(cars, fraction))

    def _turn_aside(
        self, cars: Ints, fraction: Floats, offset_m: Floats | None, angle_deg: Floats | None
    ) -> None:
        nothing = np.zeros(len(cars))
        offset_m = nothing if offset_m is None else np.asarray(offset_m, np.float64)
        angle_deg = nothing if angle_deg is None else np.asarray(angle_deg, np.float64)
        on_line = np.ones(len(cars), np.bool_)
        if self._traffic is not None:
            on_line = self._traffic.start_lane(cars) == CENTER
        # Only these: reading a pose and placing the car there again may change its last bit.
        moved = np.flatnonzero((offset_m != 0.0) | (angle_deg != 0.0))
        poses = self._poses(cars[moved])
        for row, k in enumerate(moved):
            if on_line[k]:
                track = self._placing.tracks[self._placing.backward[cars[k]]]
                poses[row] = start_pose(track, fraction[k], offset_m[k], angle_deg[k]).pose
            else:
                poses[row, 2] += np.radians(angle_deg[k])
        self._cars.place(cars[moved], poses)
        self._follow()

    def _poses(self, cars: Ints) -> Floats:
        return np.column_stack([self._cars.origin_xy[cars], self._cars.yaw_rad[cars]])

    def _follow(self) -> None:
        if self._traffic is not None:
            self._traffic.follow(self._cars.origin_xy, self._cars.yaw_rad)
