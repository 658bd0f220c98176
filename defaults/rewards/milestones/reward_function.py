# What the car has passed in this episode. Each car has its own copy of these variables.
passed = {"milestone": None, "steps": 0, "progress": 0.0}


def reward_function(params):
    """Milestones: a large reward at every tenth of the lap, larger the sooner it is reached.

    The milestones are waypoints. Between them a small reward keeps the car on the road.
    """
    MILESTONES = 10  # on one lap
    USUAL_PACE = 1.5  # speed in m/s at which a milestone earns BONUS
    BONUS = 10.0  # as much as this many steps in the middle of the road
    STEPS_PER_SECOND = 15.0

    # Which part of the lap the next waypoint is in. Waypoints are numbered in driving direction.
    next_waypoint = params["closest_waypoints"][1]
    milestone = next_waypoint * MILESTONES // max(len(params["waypoints"]), 1)

    # A new episode or a new lap: steps count from the start again.
    if passed["milestone"] is None or params["steps"] <= passed["steps"]:
        passed.update(milestone=milestone, steps=0, progress=0.0)

    bonus = 0.0
    # More progress, because a car that turns round passes the same waypoints again.
    if milestone != passed["milestone"] and params["progress"] > passed["progress"]:
        metres = (params["progress"] - passed["progress"]) / 100.0 * params["track_length"]
        seconds = (params["steps"] - passed["steps"]) / STEPS_PER_SECOND
        pace = metres / max(seconds, 1.0 / STEPS_PER_SECOND)
        bonus = BONUS * min(pace / USUAL_PACE, 3.0)
        passed.update(milestone=milestone, steps=params["steps"], progress=params["progress"])

    # Off the road, or into something: nothing is earned, not even a milestone.
    if params["is_crashed"] or params["is_offtrack"] or not params["all_wheels_on_track"]:
        return 1e-3

    from_center = params["distance_from_center"] / (params["track_width"] / 2)
    return float(max(1e-3, 0.5 * (1.0 - from_center**2)) + bonus)
