"""Disturbances as for a real car; off by default."""

from typing import Literal

from drcli.config.fields import Group, setting


class RealismSettings(Group, title="Sim-to-real extras"):
    """Drawn again for each episode."""

    sim_extras_in: Literal["both", "training", "evaluation"] = setting(
        "DR_SIM_EXTRAS_IN", "both", "Where the DR_SIM_ settings below apply."
    )
    sim_image_noise: float = setting(
        "DR_SIM_IMAGE_NOISE",
        0.0,
        "Noise in every pixel: standard deviation in greys of 0 to 255.",
        between=(0, 128),
    )
    sim_brightness: float = setting(
        "DR_SIM_BRIGHTNESS",
        0.0,
        "Brightness: changed by up to this fraction in each episode.",
        between=(0, 0.9),
    )
    sim_blur: float = setting(
        "DR_SIM_BLUR",
        0.0,
        "Blur: up to this standard deviation in each episode, in pixels of a row of 160.",
        between=(0, 4),
    )
    sim_glare: float = setting(
        "DR_SIM_GLARE",
        0.0,
        "Glare of a lamp or window beyond the walls: up to this strength in each episode.",
        between=(0, 1),
    )
    sim_reflections: float = setting(
        "DR_SIM_REFLECTIONS",
        0.0,
        "Lamps above the track, mirrored by the floor: up to this strength in each episode.",
        between=(0, 1),
    )
    sim_camera_angle: float = setting(
        "DR_SIM_CAMERA_ANGLE",
        0.0,
        "Camera turned by up to this many degrees in roll, pitch and yaw.",
        between=(0, 20),
    )
    sim_camera_shift: float = setting(
        "DR_SIM_CAMERA_SHIFT",
        0.0,
        "Camera moved by up to this many metres forward, sideways and upwards.",
        between=(0, 0.05),
    )
    sim_latency: float = setting(
        "DR_SIM_LATENCY", 0.0, "Delay of every action, seconds.", between=(0, 0.5)
    )
    sim_latency_jitter: float = setting(
        "DR_SIM_LATENCY_JITTER",
        0.0,
        "Additional delay, drawn for each episode up to this many seconds.",
        between=(0, 0.5),
    )
    sim_friction: float = setting(
        "DR_SIM_FRICTION",
        0.0,
        "Grip: changed by up to this fraction in each episode.",
        between=(0, 0.9),
    )
    sim_mass: float = setting(
        "DR_SIM_MASS",
        0.0,
        "Mass of the car: changed by up to this fraction in each episode.",
        between=(0, 0.9),
    )
    sim_battery: float = setting(
        "DR_SIM_BATTERY",
        0.0,
        "Motor strength, as with a full or a weak battery: changed by up to this fraction.",
        between=(0, 0.9),
    )
    sim_steering_trim: float = setting(
        "DR_SIM_STEERING_TRIM",
        0.0,
        "Wheels that should stand straight point up to this many degrees to the left or right.",
        between=(0, 15),
    )
    sim_steering_lock: float = setting(
        "DR_SIM_STEERING_LOCK",
        0.0,
        "How far the wheels turn to the left and to the right: changed by up to this fraction.",
        between=(0, 0.9),
    )


class OwnCarSettings(Group, title="Your car"):
    """Measured on your own car; used in every episode."""

    car_steering_left: float = setting(
        "DR_CAR_STEERING_LEFT",
        30.0,
        "Degrees that the wheels turn to the left at most; smaller angles are scaled with it.",
        between=(5, 45),
    )
    car_steering_right: float = setting(
        "DR_CAR_STEERING_RIGHT",
        30.0,
        "Degrees that the wheels turn to the right at most; smaller angles are scaled with it.",
        between=(5, 45),
    )
    car_steering_trim: float = setting(
        "DR_CAR_STEERING_TRIM",
        0.0,
        "Degrees to the left (right if negative) at which wheels stand that should stand straight.",
        between=(-15, 15),
    )
    car_max_speed: float = setting(
        "DR_CAR_MAX_SPEED",
        4.0,
        "Top speed of the car in m/s; it drives no faster, whatever the action says.",
        between=(0.2, 4),
    )
    car_battery: float = setting(
        "DR_CAR_BATTERY",
        1.0,
        "Motor strength: factor on the speed that an action reaches, and on the torque.",
        between=(0.2, 1.5),
    )
