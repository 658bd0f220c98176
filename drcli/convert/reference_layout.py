"""Names and shapes of variables in a PPO checkpoint of the reference.

Independent of the export, which is compared with it: the reference silently skips variables that do
not match.

Sources: a checkpoint of the console (continuous, shallow); for others, TensorFlow 2.12 gives these
names below the reference's scopes, with `tf.layers` (the consoles) and `tf.keras.layers` (release
6). Layers are numbered with the activations between them: 0, 2, 4 ...
"""

from collections.abc import Iterable, Mapping, Sequence

from drcli.model.files.sensors import SENSORS

SCOPE = "main_level/agent/main/online/"
Shape = tuple[int, ...]

_SHALLOW = "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
_MIDDLE = "DEEP_CONVOLUTIONAL_NETWORK"
_DEEP = "DEEP_CONVOLUTIONAL_NETWORK_DEEP"

NETWORKS = (_SHALLOW, _MIDDLE, _DEEP)
_STEREO: dict[str, Shape] = {
    "Conv2d_0": (3, 3, 2, 32),
    "Conv2d_2": (3, 3, 32, 64),
    "Conv2d_4": (3, 3, 64, 64),
    "Conv2d_6": (3, 3, 64, 128),
    "Conv2d_8": (3, 3, 128, 128),
}

_CAMERA: dict[tuple[str, int], dict[str, Shape]] = {
    (_SHALLOW, 1): {
        "Conv2d_0": (8, 8, 1, 32),
        "Conv2d_2": (4, 4, 32, 64),
        "Conv2d_4": (3, 3, 64, 64),
    },
    (_SHALLOW, 2): {
        "Conv2d_0": (8, 8, 2, 32),
        "Conv2d_2": (4, 4, 32, 64),
        "Conv2d_4": (3, 3, 64, 64),
    },
    (_MIDDLE, 1): {
        "Conv2d_0": (5, 5, 1, 32),
        "Conv2d_2": (3, 3, 32, 32),
        "Conv2d_4": (3, 3, 32, 64),
        "Conv2d_6": (3, 3, 64, 64),
        "Dense_8": (64, 64),
    },
    (_MIDDLE, 2): _STEREO,
    (_DEEP, 1): {
        "Conv2d_0": (8, 8, 1, 32),
        "Conv2d_2": (4, 4, 32, 32),
        "Conv2d_4": (4, 4, 32, 64),
        "Conv2d_6": (3, 3, 64, 64),
        "Dense_8": (64, 512),
        "Dense_10": (512, 512),
    },
    (_DEEP, 2): _STEREO,
}
"""Kernels: (rows, columns, channels, filters), or (inputs, outputs) of dense layers."""

_FEATURES = {
    (_SHALLOW, 1): 11_264,
    (_SHALLOW, 2): 11_264,
    (_MIDDLE, 1): 56_000,
    (_MIDDLE, 2): 112_000,
    (_DEEP, 1): 9_216,
    (_DEEP, 2): 112_000,
}
_MIDDLEWARE: dict[str, tuple[tuple[str, int], ...]] = {
    _SHALLOW: (("Dense_0", 512),),
    _MIDDLE: (("Dense_0", 512),),
    _DEEP: (("Dense_0", 256), ("Dense_2", 128)),
}
_LIDAR_WIDTHS = (("Dense_0", 256), ("Dense_2", 256))

BODIES = ("network_0/", "network_1/")
"""Of the value and of the policy."""

RESCALER = "gradients_from_head_0-0_rescalers"


def reference_layout(
    network: str,
    sensors: Sequence[str],
    *,
    scan_dims: int,
    num_actions: int,
    continuous: bool,
) -> dict[str, Shape]:
    """Shapes of all variables by name, without `SCOPE`."""
    found: dict[str, Shape] = {}
    for body in BODIES:
        for sensor in sensors:
            if eyes := SENSORS[sensor].eyes:
                kernels = _CAMERA[network, eyes]
                features = _FEATURES[network, eyes]
            else:
                kernels = _dense(scan_dims, _LIDAR_WIDTHS)
            found |= _variables(f"{body}{sensor}/", kernels)
        width = features + (256 if len(sensors) > 1 else 0)
        kernels = _dense(width, _MIDDLEWARE[network])
        found |= _variables(f"{body}middleware_fc_embedder/", kernels)
        found[body + RESCALER] = ()
    width = _MIDDLEWARE[network][-1][1]
    found |= _variables("network_0/v_values_head_0/", {"output": (width, 1)})
    policy = "policy_mean" if continuous else "policy_fc"
    found |= _variables("network_1/ppo_head_0/", {policy: (width, num_actions)})
    if continuous:
        found["network_1/ppo_head_0/policy_log_std"] = (1, num_actions)
    return found


def differences(found: Mapping[str, Shape], wanted: Mapping[str, Shape]) -> list[str]:
    missing = [f"{name} is missing" for name in wanted if name not in found]
    extra = [f"{name} is not known" for name in found if name not in wanted]
    other = [
        f"{name} has the shape {_text(found[name])} instead of {_text(shape)}"
        for name, shape in wanted.items()
        if name in found and found[name] != shape
    ]
    return [*missing, *extra, *other]


def _dense(width: int, layers: Iterable[tuple[str, int]]) -> dict[str, Shape]:
    kernels: dict[str, Shape] = {}
    for name, after in layers:
        kernels[name] = (width, after)
        width = after
    return kernels


def _variables(scope: str, kernels: Mapping[str, Shape]) -> dict[str, Shape]:
    found: dict[str, Shape] = {}
    for name, shape in kernels.items():
        found[f"{scope}{name}/kernel"] = shape
        found[f"{scope}{name}/bias"] = shape[-1:]
    return found


def _text(shape: Shape) -> str:
    return "(" + ", ".join(map(str, shape)) + ")"
