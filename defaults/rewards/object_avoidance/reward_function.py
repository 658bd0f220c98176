import math


def reward_function(params):
    """Drive round what stands on the road.

    On a free road this is a plain "stay on the road" reward. The nearer an object comes, the less
    that counts, and the more how far to the side of the object the car is.
    """
    LOOK_AHEAD = 3.0  # metres from an object at which it begins to count
    PASSED = 0.6  # metres beyond an object at which the whole car is past it
    TOUCHING = 0.30  # metres from the middle of the car to that of the object, sideways: a scrape
    SAFE = 0.50  # metres, likewise, that leave room on either side

    # A crash ends the episode, like leaving the road. All that could still have been earned is
    # lost, which is punishment enough.
    if params["is_crashed"] or params["is_offtrack"]:
        return 1e-3

    # Where the car is across the road: left of the centre line is positive.
    half_width = max(params["track_width"] / 2.0, 0.01)
    across = params["distance_from_center"] * (1.0 if params["is_left_of_center"] else -1.0)

    # Free road: half of its width is as good as the middle, so that the car need not first unlearn
    # to follow the centre line before it can leave it for an object.
    free_road = min(1.0, max(0.0, 2.0 - 2.0 * abs(across) / half_width))
    reward = free_road

    # The last object and the next one. Objects stand in the middle of the left or the right lane.
    heading = math.radians(params["heading"])
    for number in set(params["closest_objects"]):
        if number >= len(params["objects_location"]):
            continue  # there are no objects on this track
        x, y = params["objects_location"][number][:2]
        to_x, to_y = x - params["x"], y - params["y"]
        away = math.hypot(to_x, to_y)
        ahead = to_x * math.cos(heading) + to_y * math.sin(heading)
        if away > LOOK_AHEAD or ahead < -PASSED:
            continue
        lane = half_width / 2.0 if params["objects_left_of_center"][number] else -half_width / 2.0
        # Little on a line that ends in the object, all on one that passes it with room to spare. On
        # a narrow road that line runs near the edge, so the edge does not count here.
        gap = abs(across - lane)
        clear = 0.3 * min(gap / TOUCHING, 1.0)
        clear += 0.7 * min(max((gap - TOUCHING) / (SAFE - TOUCHING), 0.0), 1.0)
        urgency = 1.0 - 0.6 * away / LOOK_AHEAD
        reward = min(reward, urgency * clear + (1.0 - urgency) * free_road)
    return float(max(reward, 1e-3))
