"""Calls the reward functions of many cars."""

from collections.abc import Callable, Sequence

import numpy as np

from drsim.arrays import Bools, Floats
from drsim.episode.params import Situation, params_of
from drsim.episode.reward import RewardFunction, RewardHost, checked_rewards
from drsim.errors import RewardError
from drsim.track.track import Track


class RewardCalls:
    """Rewards by the reward function of each car."""

    def __init__(
        self,
        functions: Sequence[RewardFunction] | RewardHost,
        deadline_s: float,
        on_error: Callable[[RewardError, int], float] | None,
        clock: Callable[[], float],
    ) -> None:
        self.made = 0
        self._functions = functions
        self._deadline_s = deadline_s
        self._on_error = on_error
        self._clock = clock

    def rewards(
        self, tracks: tuple[Track, Track], situation: Situation, driven: Bools
    ) -> tuple[Floats, Floats, Bools, Bools]:
        """Rewards, seconds of the calls, which failed, whose episodes are declared broken.

        Raises:
            RewardError: A function failed, and nobody takes its failure.
        """
        cars = np.flatnonzero(driven)
        rewards, seconds = np.zeros(len(driven)), np.zeros(len(driven))
        failed, discarded = np.zeros(len(driven), np.bool_), np.zeros(len(driven), np.bool_)

        def instead(call: int, error: RewardError) -> float:
            made = begun + call + 1
            if error.kind == "discard":
                discarded[cars[call]] = True
                if self._on_error is not None:
                    self._on_error(error, made)
                return 0.0
            if self._on_error is None:
                raise error from error.__cause__
            failed[cars[call]] = True
            return self._on_error(error, made)

        begun = self.made
        self.made += len(cars)
        calls = params_of(tracks, situation, cars)
        if isinstance(self._functions, RewardHost):
            found = self._functions.rewards(cars.tolist(), calls, self._deadline_s, instead)
        else:
            own = [self._functions[car] for car in cars.tolist()]
            found = checked_rewards(own, calls, self._deadline_s, instead, self._clock)
        rewards[cars], seconds[cars] = found
        return rewards, seconds, failed, discarded

    def close(self) -> None:
        if isinstance(self._functions, RewardHost):
            self._functions.close()
