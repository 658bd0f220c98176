"""One training as tables: what the analysis reads, and what verdict, advice and report use.

The names of columns are those of deepracer-utils where it has one, so that racers' own notebooks
and ours speak of the same things.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from drcli.exchange.laps import Laps, lap_time, laps_summary
from drcli.modelfiles.action_space import ActionSpace
from drcli.tracks.limit_store import StoredLimit
from drsim.track.track import Track

if TYPE_CHECKING:
    import pandas as pd

Layout = Literal["drfc", "drfc-workers", "console", "droa", "upload"]
"""How the files of a model lie in a folder, a bucket or an archive.

`drfc`: training-simtrace/ of one worker; `drfc-workers`: 0/training-simtrace/,
1/training-simtrace/ ...; `console`: what the DeepRacer console let users download; `droa`:
DeepRacer on AWS; `upload`: a model without training traces, perhaps with evaluations.
"""


@dataclass(frozen=True)
class StoredEvaluation:
    """An evaluation that was driven after or beside the training.

    Attributes:
        stamp: What tells it from others: 14 digits of date and time, or the name of its folder.
        world: Where it was driven; None if not known.
        steps: Its trace, a row a step, with the columns of `Run.steps` but for `unique_episode`;
            `episode` counts the trials from 0.
        trials: A row a trial: trial, time (s, penalties included), progress (%), complete (as the
            reference counts it: after resets too), crashed, off_track, resets, clean (a lap without
            a reset and without a penalty), penalty_s (waited after resets), driven_s (time without
            it) and alone_progress (%, where the car first broke a rule). The last three are NaN
            where they are not known: metrics tell no place, and those of others no penalty.
    """

    stamp: str
    world: str | None
    steps: "pd.DataFrame"
    trials: "pd.DataFrame"

    @property
    def laps(self) -> Laps:
        """Its trials as a sample of laps."""
        return Laps(len(self.trials), self.trials.loc[self._are("clean"), "time"].tolist())

    @property
    def resets(self) -> int:
        """How often the car was put back, in all trials."""
        return int(self.trials["resets"].sum())

    @property
    def finished(self) -> int:
        """Number of finished laps, clean or not."""
        return int(self._are("complete").sum())

    @property
    def best(self) -> str:
        """Time of the fastest clean lap, else of the fastest finished one with its resets."""
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
        name: The model's name.
        origin: s3://bucket/prefix, folder or archive, as the user named it.
        layout: How its files lie.
        world: The track's name; None if neither a file nor the traces tell it.
        track: The track of that name; None if unknown or not installed.
        hyperparameters: hyperparameters.json; may be empty.
        actions: The action space of model_metadata.json; None if that is missing or damaged.
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
            eval_best_lap_s (of the evaluations during training), wall_s (the iteration's share of
            the run's duration; NaN where there was none), traced (False where no trace was
            read and the numbers are those of the metrics) and phase (of a training with a
            teacher; else empty).
        learner: A row for each update; index iteration, sorted; may be empty. entropy, kl,
            policy_loss, value_loss, clip_fraction, learning_rate, update_s ... as far as known.
        evaluations: Evaluations on their own, the oldest first.
        problems: What was wrong with the files and what was done about it, a sentence each.
        parent: The model that this one was started from, where a record says so.
        files: The racer's files and settings as text, by name: reward_function.py,
            hyperparameters.json, model_metadata.json, settings.
        parent_files: The same of the parent, where it could be read.
        records: A row for each episode in the metrics, in both phases: phase ("training" or
            "evaluation"), iteration, worker, episode (from 1), reward, progress, time, complete,
            status. Whole numbers, as metrics files have them; None where nothing was read.
        machine_hours: Of all starts of the training; None if unknown.
        cost_usd: What these cost; None if unknown.
        limit: The fastest line of its car on its track; None if unknown.
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
