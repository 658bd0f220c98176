"""The columns of a simtrace, also for docs/glossary.md."""

from collections.abc import Mapping

TRACE_COLUMNS: Mapping[str, str] = {
    "episode": "Number of the episode in this training or evaluation, from 0.",
    "steps": "Number of the step in the episode, from 1. In step 1 the car is put on the road.",
    "X": "Position of a point at the front of the car, metres.",
    "Y": "Position of a point at the front of the car, metres.",
    "yaw": "Direction in which the car points, degrees.",
    "steer": "Requested steering angle, degrees, left is positive.",
    "throttle": "Requested speed, m/s. The name is older than its meaning.",
    "action": "Number of the action, from 0; of continuous actions, steering and speed in "
    "brackets.",
    "reward": "What the reward function returned for this step.",
    "done": "True in the last step of the episode.",
    "all_wheels_on_track": "True if all four wheels are on the road.",
    "progress": "Share of the lap that is done, percent.",
    "closest_waypoint": "Number of the nearest waypoint.",
    "track_len": "Length of the centre line, metres.",
    "tstamp": "Simulated time, seconds.",
    "episode_status": "How it goes: prepare, in_progress, lap_complete, off_track, crashed, "
    "immobilized, reversed, pause, park or time_up.",
    "pause_duration": "Seconds of a penalty that are left.",
    "obstacle_crash_counter": "Crashes into objects in this episode.",
    "wall_clock": "Time of day, seconds since 1970.",
    "reward_ms": "How long the call of the reward function took, milliseconds; 0 in steps without "
    "a call. Traces of DeepRacer-for-Cloud do not have this column.",
}
