"""Evaluates checkpoints on a second track: DR_TRAIN_EVAL_WORLD."""

from collections.abc import Callable

from drcli.config.run_config import RaceConfig
from drcli.exchange.scores import SecondEvaluation
from drcli.modelfiles.model_metadata import ModelMetadata
from drcli.workers.build_race import build_simulation, load_world, longest_episode
from drcli.workers.driven_episode import Driven, columns_of
from drcli.workers.driving import Driver, Racer
from drcli.workers.evaluation_starts import fresh_starts
from drcli.workers.live_moment import Onlooker
from drcli.workers.reward_client import RewardProcess
from drsim.episode.episode_rules import EpisodeRules
from drsim.errors import RewardError
from drsim.track.worlds import directed


class SecondTrack:
    """A simulation of the same race on another track.

    `start_seed` is the same for all workers.

    Raises:
        ProblemsError: The track is not installed, or there is no room for obstacles or bots.
    """

    def __init__(
        self,
        race: RaceConfig,
        metadata: ModelMetadata,
        racer: Racer,
        reward: RewardProcess,
        *,
        num_threads: int,
        seed: int,
        start_seed: int,
        on_reward_error: Callable[[RewardError, int], float] | None = None,
        onlooker: Onlooker | None = None,
    ) -> None:
        self.world = race.world_name
        self._start_seed = start_seed
        self._track = track = directed(load_world(race), reverse=race.train_reverse_direction)
        self._simulation = build_simulation(
            race,
            "training",
            metadata,
            track,
            num_cars=reward.cars,
            reward=reward,
            rules=EpisodeRules(max_steps=longest_episode(track, racer.actions)),
            num_threads=num_threads,
            seed=seed,
            on_reward_error=on_reward_error,
        )
        self._driver = Driver(self._simulation, [racer], seed, onlooker=onlooker)

    def evaluate(self, trials: int, should_stop: Callable[[], bool]) -> SecondEvaluation:
        """Drive with the present weights, from starts spread over the lap.

        Broken episodes count only if there are no others.

        Raises:
            StopRequested: `should_stop` returned True.
        """
        episodes: list[Driven] = []
        plans = fresh_starts(self._track, trials, self._start_seed)
        self._driver.drive(plans, episodes.append, should_stop)
        episodes.sort(key=lambda episode: episode.number)
        sound = [episode for episode in episodes if not episode.discarded] or episodes
        return SecondEvaluation(*columns_of(sound), self.world)

    def close(self) -> None:
        self._simulation.close()


def sentence_of(result: SecondEvaluation) -> str:
    return f"drives {result.mean_progress:.1f} % of the lap on {result.world} ({result.laps})."
