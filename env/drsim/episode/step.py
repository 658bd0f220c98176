"""The result of one step of the simulation: a row of the trace for every car."""

from dataclasses import dataclass
from functools import cached_property

from drsim.arrays import Bools, Floats, Ints


@dataclass(frozen=True)
class StepResult:
    """One row of the trace for every car; arrays of shape (n,), never changed afterwards.

    All values are those after the motion of the step.

    Attributes:
        driven: The action of this step moved the car; false while it waits or is parked, and in
            the first step of an episode. Only driven steps can be learned from.
        reward: What the reward function returned; 0 where the car was not driven.
        failed: The call of the reward function failed, so that the reward is one in place of it.
        reward_time_s: Wall time of the call of the reward function; 0 where the car was not driven.
            It is measured, so it differs between equal drives.
        terminated: The episode ended by its rules in this step.
        truncated: The episode was cut off in this step, by the step limit or, with the status
            `Status.DISCARDED`, because the reward function declared it broken.
        status: Numbers of `Status`.
        progress: Percent of the lap, exactly 100 in the step that completes it.
        x: World x of the point 0.14 m ahead of the car's origin, metres.
        y: World y of that point, metres.
        yaw_deg: Heading, -180 .. 180.
        all_wheels_on_track: All four wheel centres are strictly inside the borders.
        closest_waypoint: Index of the waypoint nearest to that point.
        from_center_m: Distance of that point from the centre line, metres.
        steps: Steps of the episode, 1 for the first.
        sim_time_s: Clock of the car, which never runs backwards.
        pause_s: How long the car still has to wait, seconds.
        laps: Laps completed in this episode.
        lap_time_s: Time since the current lap began, waiting included; in the step that completes
            a lap, its lap time.
        resets: Violations forgiven in this episode.
        crashes: Crashes in this episode.
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
        """The episode ended in this step, either way. Shape (n,)."""
        return self.terminated | self.truncated
