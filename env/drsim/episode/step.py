"""The result of one step of the simulation."""

from dataclasses import dataclass
from functools import cached_property

from drsim.arrays import Bools, Floats, Ints


@dataclass(frozen=True)
class StepResult:
    """One row of the trace for every car; arrays of shape (n,), never changed afterwards.

    All values are those after the motion of the step.

    Attributes:
        driven: The action moved the car; false while it waits or is parked, and in an episode's
            first step. Only driven steps can be learned from.
        reward: 0 where the car was not driven.
        failed: The reward function failed, and this reward is in its place.
        reward_time_s: Wall time of the call; 0 where the car was not driven.
        terminated: The episode ended by its rules.
        truncated: It was cut off by the step limit or as `Status.DISCARDED`.
        status: Numbers of `Status`.
        progress: Percent of the lap, exactly 100 in the step that completes it.
        x: Of the point 0.14 m ahead of the car's origin, metres.
        y: Of that point, metres.
        yaw_deg: Heading, -180 .. 180.
        all_wheels_on_track: All wheel centres are strictly inside the borders.
        closest_waypoint: Index.
        from_center_m: Of that point.
        steps: 1 for the first.
        sim_time_s: Clock of the car, which never runs backwards.
        pause_s: Still to wait.
        laps: Completed.
        lap_time_s: Since the lap began, waiting included; in its last step, the lap time.
        resets: Violations forgiven.
        crashes: In this episode.
    """

    driven: Bools
    reward: Floats
    failed: Bools
    reward_time_s: Floats
    terminated: Bools
    truncated: Bools
    status: Ints
    progress: Floats
    x: Floats
    y: Floats
    yaw_deg: Floats
    all_wheels_on_track: Bools
    closest_waypoint: Ints
    from_center_m: Floats
    steps: Ints
    sim_time_s: Floats
    pause_s: Floats
    laps: Ints
    lap_time_s: Floats
    resets: Ints
    crashes: Ints

    @cached_property
    def done(self) -> Bools:
        """The episode ended, either way."""
        return self.terminated | self.truncated
