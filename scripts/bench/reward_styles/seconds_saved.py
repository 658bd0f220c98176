"""A class with a memory: the seconds that the car has gained on a target time."""

TARGET_S = 18.0
STEPS_PER_SECOND = 15.0


class Reward:
    """Compares each step with a car that drives the lap in the target time."""

    def __init__(self):
        """Begin before the first lap."""
        self.progress = 0.0

    def __call__(self, params):
        """Pay for the seconds saved in this step; the finish pays for the whole lap's."""
        if params["steps"] <= 2:
            self.progress = 0.0
        gained = params["progress"] - self.progress
        self.progress = params["progress"]
        if not params["all_wheels_on_track"]:
            return -1.0
        saved_s = gained / 100.0 * TARGET_S - 1.0 / STEPS_PER_SECOND
        reward = 1.0 + 10.0 * saved_s
        if params["progress"] >= 100.0:
            whole_s = params["steps"] / STEPS_PER_SECOND
            reward += 50.0 * max(0.0, 2.0 * TARGET_S - whole_s)
        return float(reward)


_reward = Reward()


def reward_function(params):
    """Pay what the object of this car says."""
    return _reward(params)
