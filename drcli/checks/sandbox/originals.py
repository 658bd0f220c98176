"""Notices what racers' code puts in place of Python's own functions, and puts those back."""

import builtins
import math
import random
import time

_SHARED = (builtins, math, random, time)
"""Modules that the simulation uses as well, in the same process."""


class Originals:
    """The modules as they are now.

    Attributes:
        replaced: What was found to be something else since, or gone, such as `math.sqrt`.
    """

    def __init__(self) -> None:
        self.replaced: list[str] = []
        self._before = [(module, dict(module.__dict__)) for module in _SHARED]

    def restore(self) -> None:
        """Put everything back, and take note of what that was. New names stay."""
        changed = [
            (module.__name__, name)
            for module, before in self._before
            for name in before
            if name not in module.__dict__ or module.__dict__[name] is not before[name]
        ]
        for module, before in self._before:
            module.__dict__.update(before)
        # Nothing but syntax so far: any function may have been replaced.
        names = [f"{module}.{name}" for module, name in changed]
        self.replaced += [name for name in names if name not in self.replaced]
