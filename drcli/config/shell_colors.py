"""The colours of DR_CAR_COLOR."""

import re

RGB = tuple[float, float, float]

_COLORS: dict[str, RGB] = {
    "Black": (0.1, 0.1, 0.1),
    "Grey": (0.529, 0.584, 0.588),
    "Blue": (0.266, 0.372, 0.898),
    "Red": (0.878, 0.101, 0.145),
    "Orange": (1.0, 0.627, 0.039),
    "White": (1.0, 1.0, 1.0),
    "Purple": (0.611, 0.164, 0.764),
}
"""Source: the reference simulator's materials."""

_HEX = re.compile(r"f1_car_#?([0-9a-fA-F]{6})")


def shell_color(name: str) -> RGB:
    """RGB, 0 to 255; red for a colour without a number."""
    match = _HEX.fullmatch(name)
    if match is not None:
        red, green, blue = bytes.fromhex(match[1])
        return float(red), float(green), float(blue)
    red_, green_, blue_ = _COLORS.get(name.capitalize(), _COLORS["Red"])
    return 255.0 * red_, 255.0 * green_, 255.0 * blue_
