"""Sim-to-real extras (run.env): disturbances as for a real car; off by default."""

from typing import Literal

from drcli.config.fields import Group, setting


class RealismSettings(Group, title="Sim-to-real extras"):
    """Disturbances of camera and car, drawn again for each episode from the seed."""

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
