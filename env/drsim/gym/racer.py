"""One car as a Gymnasium environment, driven by what it perceives."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from drsim.arrays import Ints
from drsim.car.actions import DEFAULT_ACTIONS, Actions, ContinuousActions
from drsim.car.car import CONTROL_HZ
from drsim.car.car_parameters import DEFAULT_CAR, CarParameters, car_of
from drsim.car.conditions import Conditions, Realism
from drsim.episode.episode_rules import EpisodeRules, Status, StepResult
from drsim.episode.reward import RewardFunction, centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.errors import require
from drsim.race.race import Race, race_of_name
from drsim.sensing.observations import Randomize
from drsim.sensing.sensors import Sensors, sensors_of
from drsim.track.track import Track
from drsim.track.worlds import load_track
from drsim.viewing.rendering import RENDER_MODES, VIEWS, Viewer, Window


def check_choice(name: str, value: Any, choices: tuple[Any, ...]) -> None:
    """Raise ValueError for a value that is not one of the choices."""
    words = ", ".join(repr(choice) for choice in choices)
    require(value in choices, name, repr(value), f"be one of {words}")


def check_start(start: Any) -> None:
    """Raise ValueError for a start that is neither None nor 0 to 1."""
    good = start is None or (isinstance(start, (float, int, np.number)) and bool(0 <= start <= 1))
    require(good, "start", repr(start), "be 0 .. 1 of the lap, or None for anywhere")


def checked_actions(given: Any, space: gym.Space[Any], batch: tuple[int, ...] = ()) -> NDArray[Any]:
    """Actions as an array; continuous ones beyond -1 .. 1 are accepted.

    Raises:
        ValueError: They do not have the space's shape or type, are not among its choices, or are
            not finite.
    """
    actions = np.asarray(given)
    good = actions.shape == (*batch, *(space.shape or ()))
    if isinstance(space, gym.spaces.Discrete):
        good = good and actions.dtype.kind in "iu"
        good = good and bool(((actions >= 0) & (actions < space.n)).all())
    else:
        good = good and actions.dtype.kind in "fiu" and bool(np.isfinite(actions).all())
    if not good:
        cars = f" for {batch[0]} cars" if batch else ""
        raise ValueError(f"{given!r} is not an action of {space}{cars}.")
    return actions


Perceived = Any
"""An array, or a dict of arrays by sensor name."""


class Racers:
    """What both environments share: a simulation, and how its episodes begin."""

    np_random: np.random.Generator
    _simulation: Simulation
    _sensors: Sensors

    def _set_up(
        self,
        cars: int,
        threads: int,
        world: str | Track,
        race: Race | str,
        sensors: Sensors | str | Sequence[str],
        actions: Actions,
        episode: tuple[float | None, bool],
        car: CarParameters | str,
        picture: tuple[str | None, str],
        **options: Any,
    ) -> None:
        """`episode` is start and reverse, `picture` render mode and view."""
        self.render_mode, self.view = picture
        self._start, self._reverse = episode
        check_choice("view", self.view, VIEWS)
        check_start(self._start)
        self._actions = actions
        self._sensors = sensors_of(sensors)
        self._race = race_of_name(race) if isinstance(race, str) else race
        if cars < self._race.racers:
            raise ValueError("Two racers need two drivers: use RacerVectorEnv.")
        self._simulation = Simulation(
            load_track(world) if isinstance(world, str) else world,
            num_cars=cars,
            num_threads=threads,
            race=self._race,
            sensors=self._sensors,
            car_parameters=car_of(car),
            **options,
        )
        self._viewer: Viewer | None = None

    def _begin(self, cars: Ints, options: dict[str, Any] | None) -> StepResult:
        """Options win over arguments; ValueError for a wrong one."""
        options = options or {}
        for name in options:
            check_choice("An option of reset", name, ("start", "reverse", "conditions"))
        start = options.get("start", self._start)
        check_start(start)
        racers = self._race.racers
        races = len(cars) // racers
        fractions = self.np_random.random(races) if start is None else np.full(races, float(start))
        seeds = self.np_random.integers(2**64, size=races, dtype=np.uint64)
        return self._simulation.reset(
            cars,
            np.repeat(fractions, racers),
            reverse=bool(options.get("reverse", self._reverse)),
            seeds=np.repeat(seeds, racers),
            conditions=conditions_of(options.get("conditions")),
        )

    def _seen(self, cars: int | slice) -> Perceived:
        """Copies, eyes last, colours first."""
        frames, color = self._simulation.frames[cars], self._simulation.color
        frames = frames.copy() if color else np.moveaxis(frames, -3, -1).copy()
        if self._sensors.lidar is None:
            return {self._sensors.camera: frames} if color else frames
        return {
            self._sensors.camera: frames,
            self._sensors.lidar: self._simulation.scans[cars].copy(),
        }

    @property
    def _pictures(self) -> Viewer:
        if self._viewer is None:
            self._viewer = Viewer(self._simulation, self.view)
        return self._viewer


def conditions_of(given: Any) -> Conditions | list[Conditions] | None:
    """For all cars, or one for each; ValueError for another type."""
    if given is None or isinstance(given, Conditions):
        return given
    if isinstance(given, (list, tuple)) and all(isinstance(each, Conditions) for each in given):
        return list(given)
    raise ValueError(
        f"conditions is {given!r}; it must be drsim.Conditions, or a list with one for each car."
    )


_INFO = (
    *("progress", "status", "steps", "laps", "lap_time_s", "x", "y", "yaw_deg"),
    *("closest_waypoint", "all_wheels_on_track", "crashes", "driven"),
)


def info_of(result: StepResult) -> dict[str, Any]:
    return {name: getattr(result, name) for name in _INFO}


class RacerEnv(Racers, gym.Env[Perceived, Any]):
    """One DeepRacer car on a track.

    ## Action space

    With `DiscreteActions` (the default: 5 angles, each with 1 and 2 m/s), `Discrete(n)`. With
    `ContinuousActions`, `Box(-1, 1, (2,), float32)`: steering, from the least angle to the
    greatest (left), and speed, from the least to the greatest; numbers beyond are clipped.

    The wheels turn by 30 degrees at most, with a lag of about 0.1 s; the car drives 0.1 to about
    3.6 m/s and cannot stop. One action lasts 1/15 s.

    ## Observation space

    What the sensor gives; with a camera and a lidar, a `Dict` of both by name.

    - FRONT_FACING_CAMERA, LEFT_CAMERA, observation: `Box(0, 255, (120, 160, 1), uint8)`, grey
    - STEREO_CAMERAS: `Box(0, 255, (120, 160, 2), uint8)`
    - LIDAR: `Box(0.15, 1, (64,), float32)`, metres
    - SECTOR_LIDAR: `Box(0, 1, (8,), float32)`
    - DISCRETIZED_SECTOR_LIDAR: `Box(0, 1, (sectors * values,), float32)`

    With `color=True`, a `Dict` by name in which the camera is `Box(0, 255, (3, 120, 160), uint8)`:
    red, green, blue, as in the package `deepracer` of PyPI. 0.2989, 0.5870 and
    0.1140 of them give the grey frame. STEREO_CAMERAS have no colours.

    The camera has a horizontal field of view of 64.7 degrees, pitched 14 degrees down, 0.13 m
    above the ground; row 0 is at the top. The lidar looks backwards, as in the reference: ray 0
    points 30 degrees to the left, and the rays go round by the rear.

    ## Reward

    What the reward function returns. The default: 1.0 within 10 % of the track width from the
    centre line, 0.5 within 25 %, 0.1 within 50 %, else 0.001.

    ## Start

    At rest on the centre line, at `start` (0 .. 1 of the lap), or anywhere if None; on the other
    lane near an obstacle. `reset(options={"start": 0.25, "reverse": True})` wins over the
    arguments. Everything random in an episode comes from the seed of `reset`.

    ## End of an episode

    Terminated: a full lap (progress exactly 100), a crash, all four wheels off the track, 15 steps
    without motion or of falling progress. Truncated: `rules.max_steps` reached. With
    `rules.max_resets`, a violation puts the car back on the track; it waits, and ignores actions.

    ## Info

    `progress` [%], `status` (word of the traces), `steps`, `laps`, `lap_time_s`, `x`, `y` [m],
    `yaw_deg`, `closest_waypoint`, `all_wheels_on_track`, `crashes`, `driven` (false where the
    action was ignored).

    ## Rendering

    `render_mode="rgb_array"` gives a picture, `"human"` shows it in a window (extra `rendering`).
    The `view` is "camera", (120, 160, 3), or "chase" from behind and "top" from above, (480, 640,
    3): about 1 s for the first, then 20 ms of one core.
    """

    # Not a ClassVar, because Gymnasium declares it without.
    metadata = {"render_modes": list(RENDER_MODES), "render_fps": CONTROL_HZ}  # noqa: RUF012

    def __init__(
        self,
        world: str | Track = "reinvent_base",
        *,
        reward_function: RewardFunction = centre_line_reward,
        actions: Actions = DEFAULT_ACTIONS,
        rules: EpisodeRules | None = None,
        sensors: Sensors | str | Sequence[str] = ("FRONT_FACING_CAMERA",),
        race: Race | str = "time_trial",
        start: float | None = None,
        reverse: bool = False,
        randomize: Randomize = "nothing",
        realism: Realism | None = None,
        longest_latency_s: float = 0.0,
        color: bool = False,
        car: CarParameters | str = DEFAULT_CAR,
        render_mode: str | None = None,
        view: str = "camera",
    ) -> None:
        """Build the world.

        Args:
            world: Name of a world, path of a route file, or a track.
            reward_function: Called after every driven step.
            actions: What the action numbers mean.
            rules: When episodes end; default: those of training.
            sensors: What the car perceives, or names of sensors.
            race: What else is on the track, or "time_trial", "object_avoidance", "head_to_bot".
            start: Of the lap, 0 .. 1; anywhere when None.
            reverse: Drive against the direction of the track.
            randomize: "nothing", "lights" or "textures", per episode.
            realism: Sim-to-real extras; default: none.
            longest_latency_s: Of conditions given to `reset`.
            color: Camera frames in red, green and blue.
            car: Name of car parameters (`drsim.CAR_SETS`), or your own.
            render_mode: "rgb_array", "human", or None.
            view: "camera", "chase" or "top".

        Raises:
            TrackError: There is no track of this name.
            ValueError: Another argument is wrong.
        """
        check_choice("render_mode", render_mode, (None, *RENDER_MODES))
        self._set_up(
            1,
            1,
            world,
            race,
            sensors,
            actions,
            (start, reverse),
            car,
            (render_mode, view),
            reward_function=reward_function,
            rules=rules,
            realism=realism,
            randomize=randomize,
            longest_latency_s=longest_latency_s,
            color=color,
        )
        self.action_space = actions.space()
        self.observation_space = self._sensors.space(color=color)
        self._running = False
        self._window: Window | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the window: a copy opens its own."""
        return {**self.__dict__, "_window": None}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Perceived, dict[str, Any]]:
        """Begin an episode, and return what the car perceives and info.

        `options` are `start`, 0 .. 1, `reverse`, and `conditions`: `drsim.Conditions` instead of
        what `realism` draws.
        """
        super().reset(seed=seed)
        result = self._begin(np.zeros(1, np.int64), options)
        self._running = True
        if self._viewer is not None:
            self._viewer.cut()
        self._show()
        return self._seen(0), _info_of_one(result)

    def step(self, action: Any) -> tuple[Perceived, float, bool, bool, dict[str, Any]]:
        """Act for 1/15 s: what the car perceives, reward, terminated, truncated and info.

        Raises:
            RewardError: The reward function failed.
            ResetNeeded: No episode has begun, or it is over.
            ValueError: The action is not in the action space.
        """
        if not self._running:
            raise ResetNeeded("Call reset before step: no episode has begun, or it is over.")
        request = checked_actions(action, self.action_space)
        result = self._simulation.step(*self._actions.requests(request[None]))
        self._running = not bool(result.done[0])
        self._show()
        return (
            self._seen(0),
            float(result.reward[0]),
            bool(result.terminated[0]),
            bool(result.truncated[0]),
            _info_of_one(result),
        )

    def render(self) -> Any:
        """The picture of the chosen view; None unless the render mode is rgb_array."""
        return self._pictures.picture(0) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Free threads and window. May be called twice."""
        self._simulation.close()
        if self._window is not None:
            self._window.close()
            self._window = None

    def _show(self) -> None:
        if self.render_mode != "human":
            return
        if self._window is None:
            self._window = Window()
        self._window.show(self._pictures.picture(0))


def _info_of_one(result: StepResult) -> dict[str, Any]:
    info = {name: values[0].item() for name, values in info_of(result).items()}
    info["status"] = Status(info["status"]).label
    return info


ENVIRONMENTS: dict[str, dict[str, Any]] = {
    "drsim/DeepRacer-v0": {},
    "drsim/DeepRacerContinuous-v0": {"actions": ContinuousActions((-30.0, 30.0), (1.0, 2.0))},
    "drsim/DeepRacerObjectAvoidance-v0": {"race": "object_avoidance"},
    "drsim/DeepRacerHeadToBot-v0": {"race": "head_to_bot"},
}


def register() -> None:
    """Make the ids known; may be called again."""
    for name, arguments in ENVIRONMENTS.items():
        if name not in gym.registry:
            gym.register(
                name,
                entry_point="drsim.gym.racer:RacerEnv",
                vector_entry_point="drsim.gym.racer_vector:RacerVectorEnv",
                kwargs=arguments,
                # The environment checks its actions and its order of calls by itself.
                order_enforce=False,
                disable_env_checker=True,
            )
