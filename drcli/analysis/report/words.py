"""Numbers as people read them."""

import math
from typing import SupportsFloat

UNKNOWN = "\N{EN DASH}"


def count(value: SupportsFloat) -> str:
    """In groups of three digits."""
    number = float(value)
    return f"{number:,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}") if known(number) else UNKNOWN


def digits(value: SupportsFloat) -> str:
    number = float(value)
    if not known(number):
        return UNKNOWN
    size = abs(number)
    if size and (size >= 1e6 or size < 1e-3):
        return f"{number:.2e}"
    return f"{number:.4g}" if size < 1e4 else f"{number:.0f}"


def percent(value: SupportsFloat, digits: int = 1, sign: str = "\N{NO-BREAK SPACE}%") -> str:
    number = float(value)
    return f"{number:.{digits}f}{sign}" if known(number) else UNKNOWN


def seconds(value: SupportsFloat) -> str:
    number = float(value)
    return f"{number:.3f}" if known(number) else UNKNOWN


def nth(number: int) -> str:
    """`second`, `third`, `4th`."""
    return {2: "second", 3: "third"}.get(number, f"{number}th")


def known(value: float) -> bool:
    return math.isfinite(value)
