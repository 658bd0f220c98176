"""What a simulation worker drives in a training, or in one stage of it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from drcli.base.log import plain
from drcli.config.run_config import DriveConfig
from drcli.config.track_names import races_on, training_races
from drcli.drive import reference_log
from drcli.drive.build_race import (
    build_simulation,
    load_reward,
    load_world,
    longest_episode,
    realism_of,
)
from drcli.drive.driving import Driven, Driver, Plan, Racer, columns_of
from drcli.drive.evaluator import fresh_starts
from drcli.live.step_snapshot import LiveObserver
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.model.model_store import ModelStore
from drcli.records.iteration import CONFIRMING_LAPS
from drcli.records.job import Job
from drcli.records.scores import SecondEvaluation
from drcli.records.stage import PhaseMark, RangesMark, Stage
from drcli.train.episode_share import AssignedShare, Share
from drcli.train.goals import targets_of
from drcli.train.training_progress import (
    episodes_of,
    numbered_episodes,
    parameters_of,
    teacher_drives,
)
from drcli.workers.cores import driving_threads, usable_cores
from drcli.workers.reward_failures import RewardFailures
from drsim.car.conditions import Realism
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import RewardFunction, RewardHost
from drsim.errors import RewardError
from drsim.track.track import Track
from drsim.track.worlds import directed

# Evaluates checkpoints on tracks that are never trained: DR_TRAIN_EVAL_WORLD.


class HeldOutTracks:
    """A simulation of the same race on other tracks.

    `start_seed` is the same for all workers.

    Raises:
        ProblemsError: The track is not installed, or there is no room for obstacles or bots.
    """

    def __init__(
        self,
        races: Sequence[DriveConfig],
        metadata: ModelMetadata,
        racer: Racer,
        reward: RewardFunction | RewardHost,
        *,
        num_cars: int,
        num_threads: int,
        seed: int,
        start_seed: int,
        job: Literal["training", "evaluation"] = "training",
        on_reward_error: Callable[[RewardError, int], float] | None = None,
        observer: LiveObserver | None = None,
    ) -> None:
        self._worlds = [race.world_name for race in races]
        self.name = self._worlds[0] if len(races) == 1 else f"{len(races)} tracks"
        self._start_seed = start_seed
        self._tracks = tracks_of(races)
        self._simulation = build_simulation(
            races[0],
            job,
            metadata,
            self._tracks,
            num_cars=num_cars,
            reward=reward,
            rules=rules_on(self._tracks, racer),
            num_threads=num_threads,
            seed=seed,
            on_reward_error=on_reward_error,
        )
        self._driver = Driver(self._simulation, [racer], seed, observer=observer)

    def evaluate(
        self, trials: int, should_stop: Callable[[], bool], *, other_starts: int = 0
    ) -> SecondEvaluation:
        """Drive with the present weights, each track at least once, from starts spread over laps.

        Another number of `other_starts` means other places. Broken episodes count only if there are
        no others.

        Raises:
            StopRequested: `should_stop` returned True.
        """
        trials, count = max(trials, len(self._tracks)), len(self._tracks)
        seed = self._start_seed + CONFIRMATION_STRIDE * other_starts
        starts = [fresh_starts(track, trials, seed) for track in self._tracks]
        plans = [replace(starts[k % count][k], track=k % count) for k in range(trials)]
        episodes = self._driver.driven(plans, should_stop)
        sound = [episode for episode in episodes if not episode.discarded] or episodes
        failed = {self._worlds[each.track] for each in sound if not each.completed}
        return SecondEvaluation(*columns_of(sound), self.name, sorted(failed))

    def close(self) -> None:
        self._simulation.close()


def sentence_of(result: SecondEvaluation) -> str:
    failed = f"; not clean on {', '.join(result.failed)}" if result.failed else ""
    return (
        f"drives {result.mean_progress:.1f} % of the lap on {result.world} ({result.laps}{failed})."
    )


def tracks_of(races: Sequence[DriveConfig]) -> list[Track]:
    return [directed(load_world(race), reverse=race.train_reverse_direction) for race in races]


def rules_on(tracks: Sequence[Track], racer: Racer) -> EpisodeRules:
    return EpisodeRules(max_steps=max(longest_episode(track, racer.actions) for track in tracks))


LEAST_WEIGHT = 0.2
NEWEST_WEIGHT = 0.1


class TrackChoice:
    """Chooses tracks for episodes, more often those on which cars come less far.

    Nobody keeps what it has seen: after a restart all tracks are equal again.
    """

    def __init__(self, count: int) -> None:
        self._missing = np.ones(count)

    def note(self, track: int, progress: float) -> None:
        """`progress` in percent."""
        missing = 1.0 - min(progress, 100.0) / 100.0
        self._missing[track] += NEWEST_WEIGHT * (missing - self._missing[track])

    def draw(self, seed: int, number: int) -> int:
        if len(self._missing) == 1:
            return 0
        weights = LEAST_WEIGHT + self._missing
        random = np.random.default_rng([seed, number, len(weights)])
        return int(random.choice(len(weights), p=weights / weights.sum()))


SEED_STRIDE = 7_919
CONFIRMATION_STRIDE = 1_000_003
"""Between confirmations of checkpoints."""


START_OFFSET_M, START_ANGLE_DEG = 0.15, 10.0
"""For teachers and students that learn from them: who has seen this comes back to the line."""

MILD = Realism(
    image_noise=4.0,
    brightness=0.25,
    camera_angle_deg=1.0,
    latency_jitter_s=0.04,
    friction=0.15,
    battery=0.08,
    steering_trim_deg=1.5,
    glare=0.2,
    reflections=0.2,
)
"""For half of a student's episodes, where the settings name nothing: evaluations drive the nominal
car.
"""


def is_nominal(realism: Realism) -> bool:
    """Whether only the gray overlay of the car's camera may disturb."""
    return realism == Realism(gray_overlay=realism.gray_overlay)


def under(realism: Realism, plan: Plan, seed: int) -> Plan:
    return replace(plan, conditions=realism.draw(plan.seed(seed)))


def plan_of_phase(
    mark: PhaseMark, plan: Plan, seed: int, realism: Realism, *, teacher: bool
) -> Plan:
    """An episode of a training with a teacher, which drives it as the second of two racers."""
    random = np.random.Generator(np.random.Philox(key=[seed, plan.number]))
    fraction, offset, angle, nominal = random.uniform(-1.0, 1.0, 4).tolist()
    if is_nominal(realism):
        is_mild = mark.name != "teacher" and nominal > 0.0
        usual = MILD if is_mild else Realism()
        plan = under(replace(usual, gray_overlay=realism.gray_overlay), plan, seed)
    if mark.name == "ppo":
        return plan
    return replace(
        plan,
        start_fraction=0.5 + 0.5 * fraction,
        offset_m=START_OFFSET_M * offset,
        angle_deg=START_ANGLE_DEG * angle,
        racer=int(teacher),
    )


class TrainingSimulation:
    """The cars of one worker, and which episodes they drive.

    `assigned` replaces `share` once the trainer says who drives what; `trials` is 0 without
    evaluations. `ranges` is the share of the DR_SIM_ ranges from which training episodes draw;
    evaluations draw from all, so that checkpoints can be compared.
    """

    def __init__(
        self,
        job: Job,
        model: ModelStore,
        design: Design,
        racers: Sequence[Racer],
        stage: Stage | None,
        *,
        worker: int,
        divisor: int,
        joined: bool = False,
        gpu: bool = False,
        on_reward_error: Callable[[RewardError, int], float],
        observer: LiveObserver | None = None,
    ) -> None:
        """A `joined` worker's part may become larger; `divisor` is of the cars at a time.

        `on_reward_error` is as in `Simulation`.

        Raises:
            SettingsError: The reward function cannot be loaded, the track is not installed, or
                there is no room for obstacles or bots.
        """
        self._job = job
        train, prefix, metadata = job.config.train, model.prefix, design.metadata
        self.race = race = job.config.race(worker) if stage is None else stage.race(worker)
        self.stage = stage
        self._parameters = parameters_of(stage, design.parameters)
        self.assigned: AssignedShare | None = None
        self.phase: PhaseMark | None = None
        self.ranges = 1.0
        racer = racers[0]
        self.share = Share(
            worker,
            max(1, train.workers),
            self._parameters.num_episodes_between_training,
            numbered_episodes(job.stages, design.parameters),
        )
        plain.info(reference_log.start_lines(prefix, race, metadata, self._parameters, "TRAINING"))
        self.targets = targets_of(job, stage)
        # Every checkpoint is evaluated at least once, or there would be no best checkpoint.
        trials = max([train.eval_laps, *(target.laps or 0 for target in self.targets)])
        # Without a worker of its own, any of those that have joined may have to evaluate.
        evaluates = train.workers == 0 if joined else worker == 0
        self.trials = trials if evaluates else 0
        episodes = self.share.count
        if joined or self._parameters.taught:
            episodes = self.share.most
        num_cars = -(-(race.train_lanes or episodes + self.trials) // divisor)
        folder = job.folder / f"sim-{worker}"
        reward = load_reward(model, folder, num_cars, stage, job.inputs)
        tracks = tracks_of(training_races(race))
        self._track = tracks[0]
        self._choice = TrackChoice(len(tracks))
        threads = usable_cores(train) if joined else driving_threads(train)
        seed = job.seed + SEED_STRIDE * worker
        self._realism = realism_of(race, "training")
        self._simulation = build_simulation(
            race,
            "training",
            metadata,
            tracks,
            num_cars=num_cars,
            reward=reward,
            rules=rules_on(tracks, racer),
            num_threads=threads,
            seed=seed,
            on_reward_error=on_reward_error,
            longest_latency_s=MILD.longest_latency_s if self._parameters.taught else 0.0,
            gpu=gpu,
        )
        self._seed = seed
        self._driver = Driver(self._simulation, racers, seed, observer=observer)
        held_out = races_on(race, "DR_TRAIN_EVAL_WORLD") if evaluates else []
        self.held_out: HeldOutTracks | None = None
        if held_out:
            cars = -(-max(trials, len(held_out)) // divisor)
            self.held_out = HeldOutTracks(
                held_out,
                metadata,
                racer,
                load_reward(model, folder, cars, stage, job.inputs),
                num_cars=cars,
                num_threads=threads,
                seed=seed,
                start_seed=job.seed,
                # Counted apart: its calls are none of the training.
                on_reward_error=RewardFailures(train, worker).handle,
                observer=observer,
            )

    def enter_phase(self, mark: PhaseMark | None) -> None:
        self.phase = mark
        self.share = replace(self.share, episodes=episodes_of(mark, self._parameters))
        self._simulation.draws = mark is None or mark.name != "teacher"
        self._choice = TrackChoice(len(self._simulation.tracks))

    def enter_ranges(self, mark: RangesMark | None) -> None:
        self.ranges = mark.share if mark is not None and self.race.sim_grow else 1.0

    @property
    def part(self) -> Share | AssignedShare:
        return self.assigned or self.share

    @property
    def reward_calls(self) -> int:
        return self._simulation.reward_calls

    def drive(
        self,
        plans: list[Plan],
        on_end: Callable[[Driven], None],
        should_stop: Callable[[], bool],
        policy_steps: int,
    ) -> None:
        def ended(episode: Driven) -> None:
            if episode.phase == "training":
                self._choice.note(episode.track, episode.progress)
            on_end(episode)

        self._driver.drive(plans, ended, should_stop, self._epsilon(policy_steps))

    def drive_again(self, plans: list[Plan], should_stop: Callable[[], bool]) -> list[Driven]:
        """With the cars of evaluations if there are enough.

        The variables of their reward functions must not reach training episodes.

        Raises:
            StopRequested: `should_stop` returned True.
        """
        cars = self._simulation.num_cars
        own = range(max(0, cars - self.trials), cars)
        return self._driver.driven(plans, should_stop, own)

    def plans(
        self, numbers: range, trials: int, attempt: int = 0, *, iteration: int = 0
    ) -> list[Plan]:
        race = self.race
        offset = race.train_start_position_offset
        advance = race.train_round_robin_advance_dist if race.train_change_start_position else 0.0
        alternate = race.train_alternate_driving_direction
        plans = [
            Plan(
                number,
                "training",
                (offset + self.part.position(number) * advance) % 1.0,
                reverse=alternate and number % 2 == 1,
                attempt=attempt,
                track=self._choice.draw(self._seed, number),
            )
            for number in numbers
        ]
        trial_plans = fresh_starts(self._track, trials, self._job.seed) if trials else []
        if self.ranges < 1.0:
            narrow = self._realism.scaled(self.ranges)
            plans = [under(narrow, plan, self._seed) for plan in plans]
        if self.phase is not None:
            realism = self._realism.scaled(self.ranges)
            plans = [
                plan_of_phase(
                    self.phase,
                    plan,
                    self._seed,
                    realism,
                    teacher=teacher_drives(self.phase, iteration, self.part.position(plan.number)),
                )
                for plan in plans
            ]
        if self.ranges < 1.0 or (self.phase is not None and is_nominal(self._realism)):
            trial_plans = [under(self._realism, plan, self._seed) for plan in trial_plans]
        return plans + trial_plans

    def confirmation_plans(self, number: int, count: int) -> list[Plan]:
        """Their numbers, and so their random numbers, are those of no evaluation."""
        first = self.trials + number * max(CONFIRMING_LAPS, self.trials)
        plans = fresh_starts(
            self._track, count, self._job.seed + CONFIRMATION_STRIDE * (number + 1)
        )
        return [replace(plan, number=first + plan.number) for plan in plans]

    def close(self) -> None:
        self._simulation.close()
        if self.held_out is not None:
            self.held_out.close()

    def _epsilon(self, policy_steps: int) -> Callable[[int], float] | None:
        p = self._parameters
        workers = len(self.assigned.shares.workers) if self.assigned else self.share.workers
        in_phase = self.phase is not None and self.phase.name != "ppo"
        if p.exploration_type != "e-greedy" or in_phase:
            return None

        def share(driven: int) -> float:
            done = min(1.0, (policy_steps + driven * workers) / p.epsilon_steps)
            return 1.0 + (p.e_greedy_value - 1.0) * done

        return share
