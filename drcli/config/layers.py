"""Flag, process environment, run.env and system.env on top of each other, with $NAME filled in.

A reference takes the value that wins in the end, wherever it is set: overriding the model prefix
with a flag moves the metrics folder that run.env derives from it too. A name that refers to itself
means the value below its own layer.
"""

import re
from collections.abc import Mapping, Sequence

from drcli.base.problems import Place, Problem, shown
from drcli.config.env_file import Entry
from drcli.config.setting_problems import setting_problem

LONGEST_VALUE = 4096
"""Characters of a filled-in value, so that names that repeat each other cannot fill the memory."""

DEEPEST_CHAIN = 20
"""Names that may refer to each other in a row."""

_REFERENCE = re.compile(r"\\\$|\$\{(\w+)(?::-([^}]*))?\}|\$([A-Za-z_]\w*)", re.ASCII)


def references(value: str) -> set[str]:
    """Names that a text refers to."""
    found = {match[1] or match[3] for match in _REFERENCE.finditer(value)}
    return found - {None}


class Layers:
    """Looks up names: in entries by name, the strongest layer first, then in defaults."""

    def __init__(self, layers: Sequence[Mapping[str, Entry]], defaults: Mapping[str, str]) -> None:
        self.problems: dict[str, Problem] = {}
        """Why the value of a name could not be filled in."""
        self.referenced: set[str] = set()
        """Names that some value refers to."""
        self._layers = layers
        self._defaults = defaults
        self._known: dict[str, str] = {}

    def find(self, name: str) -> Entry | None:
        """What was written in the strongest layer that has the name."""
        return next((layer[name] for layer in self._layers if name in layer), None)

    def place(self, name: str) -> Place:
        """Where the name was written; `default` where nobody did."""
        entry = self.find(name)
        return Place("default") if entry is None else entry.place

    def names(self) -> set[str]:
        """Every name that somebody wrote."""
        return set().union(*self._layers)

    def text(self, name: str) -> str | None:
        """The value of a name with everything filled in; None when it is set nowhere."""
        return self._text(name, 0, ())

    def _text(self, name: str, depth: int, trail: tuple[str, ...]) -> str | None:
        if depth == 0 and name in self._known:
            return self._known[name]
        value = self._lookup(name, depth, trail)
        if depth == 0 and value is not None:
            self._known[name] = value
        return value

    def _lookup(self, name: str, depth: int, trail: tuple[str, ...]) -> str | None:
        for below, layer in enumerate(self._layers[depth:], start=depth + 1):
            if name in layer:
                return self._expand(layer[name], below, trail)
        if name in self._defaults:
            default = Entry(name, self._defaults[name], Place("default"), expands=True)
            return self._expand(default, len(self._layers), trail)
        return None

    def _expand(self, entry: Entry, below: int, trail: tuple[str, ...]) -> str:
        if not entry.expands or "$" not in entry.value:
            return entry.value
        trail = (*trail, entry.name)

        def fill(match: re.Match[str]) -> str:
            name = match[1] or match[3]
            if name is None:
                return "$"
            self.referenced.add(name)
            if name == entry.name:
                value = self._text(name, below, trail) if below < len(self._layers) else None
            elif name in trail or len(trail) > DEEPEST_CHAIN:
                self._reject(entry, f"refers to itself or through too many names ({name})")
                return ""
            else:
                value = self._text(name, 0, trail)
                if name in self.problems:
                    self.problems.setdefault(entry.name, self.problems[name])
            if not value and match[2] is not None:
                return match[2]
            if value is None:
                self._reject(entry, f"refers to {name}, which is not set", name)
                return ""
            return value

        text = _REFERENCE.sub(fill, entry.value)
        if len(text) > LONGEST_VALUE:
            self._reject(entry, f"is longer than {LONGEST_VALUE} characters once filled in")
            return ""
        return text

    def _reject(self, entry: Entry, reason: str, missing: str | None = None) -> None:
        remedy = (
            f"Set {missing} in system.env or in the environment, or write the value itself."
            if missing is not None
            else f"Write the value of {entry.name} itself."
        )
        what = f"{entry.name}={shown(entry.value)} {reason}."
        problem = setting_problem(entry.name, entry.place, what, remedy)
        self.problems.setdefault(entry.name, problem)
