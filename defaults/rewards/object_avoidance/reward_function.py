import math


def reward_function(params):
    """Drive around the objects on the road.

    On a free road this reward only says "stay on the road". The nearer an object is, the less this
    counts, and the more the sideways distance between car and object counts.
    """
    LOOK_AHEAD = 3.0  # distance in metres at which an object starts to matter
    PASSED = 0.6  # distance in metres at which the whole car is past an object
    TOUCHING = 0.30  # metres sideways between the centres of car and object: they touch
    SAFE = 0.50  # metres sideways between the centres: the car passes with room to spare

    # A crash ends the episode, like leaving the road. The car loses all further rewards,
    # which is punishment enough.
    if params["is_crashed"] or params["is_offtrack"]:
        return 1e-3

    # Distance of the car from the centre line; positive on the left.
    half_width = max(params["track_width"] / 2.0, 0.01)
    across = params["distance_from_center"] * (1.0 if params["is_left_of_center"] else -1.0)

    # Free road: the whole middle half of the road earns the full reward. So the car does not learn
    # to stay on the centre line, and can easily leave it for an object.
    free_road = min(1.0, max(0.0, 2.0 - 2.0 * abs(across) / half_width))
    reward = free_road

    # The object behind and the object ahead. They stand in the middle of the left or right lane.
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
        # Little reward on a line that hits the object, full reward on a line that passes it with
        # room to spare. On a narrow road this line is near the edge, so the edge does not count.
        gap = abs(across - lane)
        clear = 0.3 * min(gap / TOUCHING, 1.0)
        clear += 0.7 * min(max((gap - TOUCHING) / (SAFE - TOUCHING), 0.0), 1.0)
        urgency = 1.0 - 0.6 * away / LOOK_AHEAD
        reward = min(reward, urgency * clear + (1.0 - urgency) * free_road)
    return float(max(reward, 1e-3))
