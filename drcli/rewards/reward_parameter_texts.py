"""The parameters of a reward function, as in docs/reward-functions.md."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class ParameterText:
    """Texts about parameters; `unit` has the range too."""

    kind: str
    unit: str
    meaning: str


REWARD_PARAMETERS: Mapping[str, ParameterText] = {
    "all_wheels_on_track": ParameterText("bool", "", "all four wheel centres are on the road"),
    "is_offtrack": ParameterText("bool", "", "no wheel centre is on the road; the episode ends"),
    "is_crashed": ParameterText("bool", "", "the car has hit something; the episode ends"),
    "x": ParameterText("float", "m", "position of the car"),
    "y": ParameterText("float", "m", "position of the car"),
    "heading": ParameterText(
        "float", "degrees, -180 to 180", "direction in which the car points: 0 along x, 90 along y"
    ),
    "distance_from_center": ParameterText(
        "float", "m, 0 and more", "distance from the centre line"
    ),
    "is_left_of_center": ParameterText(
        "bool", "", "the car is left of the centre line, looking in driving direction"
    ),
    "track_width": ParameterText("float", "m", "width of the road here"),
    "track_length": ParameterText("float", "m", "length of the centre line"),
    "progress": ParameterText(
        "float",
        "%, up to 100",
        "how much of the lap the car has driven since the start of the episode; exactly 100 in "
        "the step that completes the lap, below 0 after driving back over the start line",
    ),
    "steps": ParameterText(
        "float",
        "2, 3, ...",
        "number of the step in the episode, 2 in the first call; 15 steps are one second",
    ),
    "sim_time": ParameterText(
        "float", "s", "clock of the simulation; it is not reset between episodes"
    ),
    "speed": ParameterText(
        "float", "m/s", "speed that the action requests; the car needs some time to reach it"
    ),
    "steering_angle": ParameterText(
        "float",
        "degrees, left positive",
        "steering angle that the action requests; the wheels turn by at most 30 degrees",
    ),
    "waypoints": ParameterText(
        "list of (x, y)",
        "m",
        "the centre line, in driving direction; on a loop the last one repeats the first "
        "([their numbers](tracks.md#waypoint-numbers))",
    ),
    "closest_waypoints": ParameterText(
        "[int, int]", "index", "the waypoint before the car and the one after it"
    ),
    "projection_distance": ParameterText(
        "float",
        "m, 0 to `track_length`",
        "distance of the car from waypoint 0, along the centre line",
    ),
    "is_reversed": ParameterText(
        "bool",
        "",
        "the settings reverse the driving direction; it does not mean that the car drives the "
        "wrong way",
    ),
    "closest_objects": ParameterText(
        "[int, int]",
        "index",
        "the object behind and the one ahead of the car, along the lap; [0, 0] without objects",
    ),
    "objects_location": ParameterText("list of [x, y]", "m", "positions of the objects"),
    "objects_distance": ParameterText(
        "list of float",
        "m, 0 to `track_length`",
        "their distances from waypoint 0, along the centre line",
    ),
    "objects_distance_from_center": ParameterText(
        "list of float", "m, 0 and more", "their distances from the centre line"
    ),
    "objects_left_of_center": ParameterText(
        "list of bool", "", "the object is left of the centre line"
    ),
    "objects_heading": ParameterText(
        "list of float", "**radians**", "direction in which bots point; 0 for boxes"
    ),
    "objects_speed": ParameterText(
        "list of float", "m/s", "speed of bots, as in the settings; 0 for boxes"
    ),
    "object_in_camera": ParameterText("bool", "", "the camera sees the next object"),
}
