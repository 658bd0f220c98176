"""The progress of each step, and a bonus of thousands for a fast finish: the pay is sparse."""

FINISH = 1000.0
TARGET_STEPS = 250.0

_last = {"progress": 0.0}


def reward_function(params):
    """Pay for the percent since the step before, and at the finish by the steps it took."""
    if params["steps"] <= 2:
        _last["progress"] = 0.0
    gained = params["progress"] - _last["progress"]
    _last["progress"] = params["progress"]
    if params["is_offtrack"]:
        return 1e-3
    reward = max(gained, 0.0)
    if params["progress"] >= 100.0:
        reward += FINISH * TARGET_STEPS / params["steps"]
    return float(reward)
