"""One training as tables, with the column names of deepracer-utils."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from drcli.base.installation import library, require
from drcli.model.files.action_space import ActionSpace
from drcli.records.iteration import Laps, lap_time, laps_summary
from drcli.tracks.limit_store import StoredLimit
from drsim.track.track import Track

if TYPE_CHECKING:
    import pandas as pd

Layout = Literal["drfc", "drfc-workers", "console", "droa", "upload"]
"""`drfc`: training-simtrace/ of one worker; `drfc-workers`: 0/training-simtrace/,
1/training-simtrace/ ...; `console`: what the DeepRacer console let users download; `droa`:
DeepRacer on AWS; `upload`: a model without training traces, perhaps with evaluations.
"""


@dataclass(frozen=True)
class StoredEvaluation:
    """An evaluation that was driven after or beside the training.

    Attributes:
        stamp: 14 digits of date and time, or the name of its folder.
        steps: Its trace, a row a step, with the columns of `Run.steps` but for `unique_episode`;
            `episode` counts the trials from 0.
        trials: A row a trial: trial, time (s, penalties included), progress (%), complete (also
            after resets, as in the reference), crashed, off_track, resets, clean (without a reset
            and a penalty), penalty_s (waited after resets), driven_s (time without it) and
            alone_progress (%, where the car first broke a rule). The last three may be NaN.
    """

    stamp: str
    world: str | None
    steps: "pd.DataFrame"
    trials: "pd.DataFrame"

    @property
    def laps(self) -> Laps:
        return Laps(len(self.trials), self.trials.loc[self._are("clean"), "time"].tolist())

    @property
    def resets(self) -> int:
        return int(self.trials["resets"].sum())

    @property
    def finished(self) -> int:
        return int(self._are("complete").sum())

    @property
    def best(self) -> str:
        """Time of the fastest clean lap, else of the fastest finished one."""
        for kind in ("clean", "complete"):
            laps = self.trials[self._are(kind)]
            if len(laps):
                row = laps.loc[laps["time"].idxmin()]
                penalty_s = None if math.isnan(row["penalty_s"]) else float(row["penalty_s"])
                return lap_time(float(row["time"]), penalty_s, int(row["resets"]))
        return ""

    def __str__(self) -> str:
        """Such as "2 of 3 laps clean (1 reset), 3 finished, best 7.73 s"."""
        return laps_summary(self.laps, resets=self.resets, finished=self.finished, best=self.best)

    def _are(self, kind: str) -> "pd.Series[bool]":
        return self.trials[kind].astype(bool)


@dataclass(frozen=True)
class Run:
    """What was read of one training.

    Attributes:
        origin: s3://bucket/prefix, folder or archive.
        track: None if unknown or not installed.
        actions: None if missing or damaged.
        steps: A row for each step of a training episode, sorted by iteration, worker, episode and
            step: episode, steps, x, y (m), yaw (degrees), steering_angle (degrees), speed (m/s),
            action (-1 where continuous), reward, done, on_track, progress (%), closest_waypoint,
            track_len (m), tstamp (s), episode_status, pause_duration (s), wall_clock (s),
            iteration, worker, unique_episode; then columns that only our traces have.
        episodes: A row for each training episode; index unique_episode, sorted. iteration,
            worker, episode, steps, start_at (waypoint), progress (%), time (s), dist (m), reward
            (sum), speed (mean, m/s), complete, status (of the last row), quintile ("1st" to "5th").
        iterations: A row for each iteration; index iteration, sorted. episodes, steps,
            mean_reward, median_reward, std_reward, best_reward, mean_progress, complete_laps,
            best_lap_s, mean_lap_s, eval_mean_reward, eval_mean_progress, eval_laps,
            eval_best_lap_s (of the evaluations during training), wall_s (NaN where unknown),
            traced (False: numbers are those of the metrics), phase (with a teacher) and
            second_clean (percent of clean laps on the tracks of DR_TRAIN_EVAL_WORLD).
        learner: A row for each update; index iteration, sorted; may be empty. entropy, kl,
            policy_loss, value_loss, clip_fraction, learning_rate, update_s ... as far as known.
        evaluations: On their own, the oldest first.
        parent: The model that this one was started from.
        files: As text: reward_function.py, hyperparameters.json, model_metadata.json, settings.
        records: A row for each episode in the metrics, in both phases: phase ("training" or
            "evaluation"), iteration, worker, episode (from 1), reward, progress, time, complete,
            status. Whole numbers.
        limit: The fastest line of its car on its track.
    """

    name: str
    origin: str
    layout: Layout
    world: str | None
    track: Track | None
    hyperparameters: Mapping[str, object]
    actions: ActionSpace | None
    steps: "pd.DataFrame"
    episodes: "pd.DataFrame"
    iterations: "pd.DataFrame"
    learner: "pd.DataFrame"
    evaluations: tuple[StoredEvaluation, ...]
    problems: tuple[str, ...]
    parent: str | None
    files: Mapping[str, str] = field(default_factory=dict)
    parent_files: Mapping[str, str] = field(default_factory=dict)
    records: "pd.DataFrame | None" = None
    machine_hours: float | None = None
    cost_usd: float | None = None
    limit: StoredLimit | None = None


# Runs of equal numbers in sorted columns.


Numbers = np.ndarray[tuple[int, ...], np.dtype[Any]]


def spans(values: Numbers) -> tuple[Numbers, Numbers]:
    """First and last index of each run. Shapes (n,), (n,)."""
    if not len(values):
        empty = np.zeros(0, np.int64)
        return empty, empty
    ends = np.flatnonzero(np.diff(values) != 0)
    return np.concatenate([[0], ends + 1]), np.concatenate([ends, [len(values) - 1]])


def deepracer_logs() -> Any:
    """The package deepracer.logs of deepracer-utils.

    Raises:
        NotAvailable: It, or pandas, is not installed.
    """
    # The library loads matplotlib.pyplot, which must not look for a display.
    os.environ.setdefault("MPLBACKEND", "Agg")
    require("pandas")
    return library("deepracer.logs")
