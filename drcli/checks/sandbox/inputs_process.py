"""Tries a racer's inputs before anything starts: does the world load, does the reward work on it?

Run by the launcher as `python -m drcli.checks.sandbox.inputs_process [FILE NAME]`: FILE is a copy
of the reward function, NAME is what its author calls it; without them only worlds and races are
loaded. Needs no torch and no bucket, so it is quick.
"""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from time import sleep  # which racers' code may put elsewhere in time
from types import TracebackType

import numpy as np

from drcli.base import signal_guard
from drcli.base.errors import SettingsError
from drcli.checks.check_report import Violation, leave_tried
from drcli.config.run_config import RaceConfig
from drcli.exchange.job import Job
from drcli.workers.build_race import load_race, load_world
from drsim.car.car import CONTROL_HZ
from drsim.episode.params import Situation, params_of
from drsim.episode.reward import (
    REWARD_DEADLINE_S,
    RewardFunction,
    RewardParams,
    checked_rewards,
    load_reward_function,
)
from drsim.errors import RewardError
from drsim.race.race import TIME_TRIAL, Race
from drsim.race.traffic import Traffic
from drsim.track.track import Track
from drsim.track.worlds import load_track

LOOK_S = 0.5
"""How often it is looked whether the launcher is there."""

POSITIONS = 40
"""Places along the lap at which the reward function is tried."""

OFFSETS = (0.0, 0.3, -0.3, 1.0)
"""Distances to the left of the centre line, in widths of the road: the last is off the track."""

STATES = {
    "on the start line": 0,
    "on the road": POSITIONS // 4,
    "after half a lap": POSITIONS // 2,
    "off the track": 3 * POSITIONS + POSITIONS // 4,
    "at the finish": POSITIONS - 1,
}
"""Five of the samples, tried first and each for itself. Source: the console's validator. The first
is the first call of an episode, in which functions set up what they keep for its other calls."""

TRIAL_SPEED_MPS = 1.0

FALLBACK_WORLD = "reinvent_base"
"""Where the reward function is tried when the racer's own track does not load."""


def try_inputs(
    configs: Sequence[RaceConfig],
    reward: tuple[Path, str] | None,
    deadline_s: float = REWARD_DEADLINE_S,
) -> list[Violation]:
    """Load the worlds and races of all workers and call the reward function along the laps.

    Args:
        configs: What the workers are going to drive.
        reward: The file, and what to call it; None tries the worlds only.
        deadline_s: How long one call may take, in seconds.
    """
    found: list[Violation] = []
    courses: list[tuple[Track, Race]] = []
    for config in configs:
        try:
            courses.append(_course(config, found))
        except SettingsError as error:
            where = str(error).partition(": ")[0]
            found.append(Violation("V-07", "error", where, str(error), error.remedy))
    if reward is None:
        return found
    path, name = reward
    try:
        function = _Watched(load_reward_function(path))
    except RewardError as error:
        named = "exactly one argument" in str(error) or "defines no function" in str(error)
        return [*found, _violation(error, "V-20" if named else "V-02", path, name)]
    for track, race in courses or [(load_track(FALLBACK_WORLD), TIME_TRIAL)]:
        wrong = list(_try(function, sample_params(track, race), deadline_s))
        found += [_violation(error, rule, path, name, state) for error, rule, state in wrong]
        if wrong:
            return found
    if function.odd is not None:
        found.append(
            Violation(
                "V-20",
                "warning",
                f"{name} line {function.line}",
                f"returned {function.odd}, which is converted to a number.",
                "End it with `return float(reward)`.",
            )
        )
    return found


def sample_params(track: Track, race: Race = TIME_TRIAL) -> list[RewardParams]:
    """Reward parameters all along a lap, on the centre line, beside it and off the track."""
    count = POSITIONS * len(OFFSETS)
    fraction = np.tile(np.linspace(0.0, 1.0, POSITIONS, endpoint=False), len(OFFSETS))
    poses = track.pose_at(fraction * track.length_m)
    where = track.locate(poses[:, :2])
    aside_m = np.repeat(OFFSETS, POSITIONS) * where.track_width_m
    left = np.stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])], axis=1)
    xy = poses[:, :2] + left * aside_m[:, None]
    off = np.repeat([abs(offset) > 0.5 for offset in OFFSETS], POSITIONS)
    progress = 100.0 * fraction
    # The last step of a lap shows exactly 100.
    progress[POSITIONS - 1] = 100.0
    situation = Situation(
        xy=xy,
        heading_deg=np.degrees(poses[:, 2]),
        where=track.locate(xy),
        all_on=~off,
        none_on=off,
        progress=progress,
        steps=np.arange(2, count + 2),
        sim_time_s=np.arange(count) / CONTROL_HZ,
        steering_deg=np.zeros(count),
        speed_mps=np.full(count, TRIAL_SPEED_MPS),
        backward=np.zeros(count, dtype=np.int64),
        # Where a car stands off the track it may as well have crashed.
        crashed=off & (race != TIME_TRIAL),
    )
    tracks = (track, track.reversed())
    if race != TIME_TRIAL:
        traffic = Traffic(tracks, count, race)
        seeds = np.arange(count, dtype=np.uint64)
        traffic.begin(np.arange(count), fraction, situation.backward, seeds)
        situation = replace(situation, objects=traffic.objects())
    return list(params_of(tracks, situation, np.arange(count)))


class _Watched:
    """A reward function that remembers the first value which was no float."""

    def __init__(self, function: RewardFunction) -> None:
        self.odd: str | None = None
        self._function = function
        # Failures are placed by the code of the racer's own function.
        self.__code__ = getattr(function, "__code__", None)

    @property
    def line(self) -> int:
        return self.__code__.co_firstlineno if self.__code__ is not None else 1

    def __call__(self, params: RewardParams) -> float:
        value = self._function(params)
        if self.odd is None and not isinstance(value, float):
            self.odd = f"{type(value).__name__} {value!r:.40}"
        return value


def _course(config: RaceConfig, found: list[Violation]) -> tuple[Track, Race]:
    """The track and race of a worker; on another track where its own does not load."""
    try:
        track = load_world(config)
    except SettingsError as error:
        where = config.source("DR_WORLD_NAME")
        found.append(Violation("V-05", "error", where, str(error), error.remedy))
        return load_track(FALLBACK_WORLD), TIME_TRIAL
    return track, load_race(config, track)


def _try(
    function: Callable[[RewardParams], float], samples: Sequence[RewardParams], deadline_s: float
) -> Iterator[tuple[RewardError, str, str]]:
    """Each failure with the rule it breaks and the state it happens in, the same failure once."""
    said: set[tuple[int | None, str]] = set()
    calls = [(state, [samples[index]]) for state, index in STATES.items()]
    rest = [call for index, call in enumerate(samples) if index not in STATES.values()]
    for state, params in [*calls, ("", rest)]:
        if said and not state:
            return
        try:
            checked_rewards(function, params, deadline_s)
        except RewardError as error:
            what = str(error).partition("\n")[0]
            if (error.line, what) not in said:
                said.add((error.line, what))
                yield error, "V-20" if "it returned" in what else "V-21", state
            if "did not return" in what:  # five times the patience would try the racer's own
                return


def _violation(error: RewardError, rule: str, path: Path, name: str, state: str = "") -> Violation:
    place = f" in {path}, line {error.line}," if error.line else f" in {path}"
    message = str(error).replace(place, "", 1).replace(str(path), name)
    if state:
        message = message.replace(" failed: ", f" failed {state}: ", 1)
    where = f"{name} line {error.line}" if error.line else name
    return Violation(rule, "error", where, message, f"Correct {name}; nothing was started.")


def main(file: Path | None, name: str) -> None:
    """Try what the job says, as a process of its own, and leave what is found in its folder."""
    job = Job.received()
    threading.Thread(target=_end_after, args=(job.launcher_pid,), daemon=True).start()
    signal_guard.install()
    if file is None:
        leave_tried(try_inputs(job.config.races, None), job.folder)
        return

    def tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        """Leave what the simulation says before it ends a process that it cannot interrupt."""
        if isinstance(error, RewardError):
            leave_tried([_violation(error, "V-21", file, name)], job.folder)
        else:
            sys.__excepthook__(kind, error, trace)

    sys.excepthook = tell
    leave_tried(try_inputs(job.config.races, (file, name)), job.folder)


def _end_after(launcher_pid: int) -> None:
    """End this process, and whatever the racer's code has started, once its launcher is gone."""
    while os.getppid() == launcher_pid:
        sleep(LOOK_S)
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    main(*((Path(sys.argv[1]), sys.argv[2]) if len(sys.argv) == 3 else (None, "")))
