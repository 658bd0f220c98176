# What the car had reached at the step before. Each car has its own copy of these variables.
before = {"steps": 0.0, "progress": 0.0}


def reward_function(params):
    """Fast laps: each step earns more the further the car gets along the track in it.

    The reward does not say which line to take or how to steer. A faster car simply earns more with
    every step, so it finds braking points and short lines by itself.
    """
    STEPS_PER_SECOND = 15.0  # the car chooses one action for each camera picture
    USUAL_PACE = 2.0  # speed in m/s that earns 1 per step; this only sets the scale
    FINISH_STEPS = 100.0  # the finish earns as much as this many further steps at the same pace

    # Steps count from the start again in a new episode or a new lap.
    if params["steps"] <= before["steps"]:
        before.update(steps=0.0, progress=0.0)
    gained = params["progress"] - before["progress"]
    steps = params["steps"] - before["steps"]
    before.update(steps=params["steps"], progress=params["progress"])

    # With a wheel off the road, a step earns almost nothing. The car may still come back; this
    # costs less than slowing down everywhere.
    if params["is_offtrack"] or not params["all_wheels_on_track"]:
        return 1e-3

    # The episode ends at the finish line, and so do its rewards. Without an extra reward, finishing
    # would look as bad as leaving the road. It is for the average speed of the whole lap.
    factor = 1.0
    if params["progress"] >= 100.0:
        gained, steps, factor = params["progress"], params["steps"], 1.0 + FINISH_STEPS

    # Speed along the centre line. Not the requested speed: a car that slides or zigzags makes less
    # progress along the track.
    metres = gained / 100.0 * params["track_length"]
    pace = min(max(metres * STEPS_PER_SECOND / max(steps, 1.0), 0.0), 5.0)

    # More than in proportion: twice the speed for half as many steps has to earn more on a lap.
    return float(max(factor * (pace / USUAL_PACE) ** 1.5, 1e-3))
