import math


def reward_function(params):
    """Overtake slow cars.

    A bot blocks one lane and crawls along it. On a free road this is a plain "stay on the road"
    reward; behind and beside a bot the other lane pays, and the lane of the bot does not.
    """
    LOOK_AHEAD = 1.8  # metres from a bot at which its lane begins to count
    PASSED = 0.7  # metres that the car has to be ahead of a bot before it may turn in
    SAFE = 0.35  # metres between the middle of the car and that of the bot, sideways

    # Running into a bot from behind ends the episode, like leaving the road. All that could still
    # have been earned is lost, which is punishment enough.
    if params["is_crashed"] or params["is_offtrack"]:
        return 1e-3

    # Where the car is across the road: left of the centre line is positive.
    half_width = max(params["track_width"] / 2.0, 0.01)
    across = params["distance_from_center"] * (1.0 if params["is_left_of_center"] else -1.0)

    # Free road: nearly the whole width is fine, only its edges are not.
    reward = max(0.0, 1.0 - (across / half_width) ** 4)

    # The bot behind and the bot ahead. Bots drive in the middle of the left or the right lane.
    heading = math.radians(params["heading"])
    for number in set(params["closest_objects"]):
        if number >= len(params["objects_location"]):
            continue  # there are no bots on this track
        x, y = params["objects_location"][number][:2]
        to_x, to_y = x - params["x"], y - params["y"]
        away = math.hypot(to_x, to_y)
        ahead = to_x * math.cos(heading) + to_y * math.sin(heading)
        if away > LOOK_AHEAD or ahead < -PASSED:
            continue
        lane = half_width / 2.0 if params["objects_left_of_center"][number] else -half_width / 2.0
        # 0 on a line that ends in the bot, 1 on one that passes it.
        clear = min(abs(across - lane) / SAFE, 1.0)
        # The nearer it is, the more it matters; one that has been passed matters less.
        urgency = (1.0 - 0.7 * away / LOOK_AHEAD) * (1.0 if ahead > 0.0 else 0.5)
        reward *= 1.0 - urgency * (1.0 - clear**2)

    if not params["all_wheels_on_track"]:
        reward *= 0.3
    return float(max(reward, 1e-3))
