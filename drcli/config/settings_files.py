"""Reads the settings files of a working folder, and puts the values on top of each other.

Files are read, never executed. Values may be in quotes; `#` after a space starts a comment.

`$NAME` means the value that wins in the end: a flag for the model prefix also moves the metrics
folder that run.env derives from it. A name that refers to itself means the layers below.
"""

import io
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dotenv.parser import Binding, parse_stream

from drcli.base.errors import Place, Problem, ProblemsError, one_of, shown
from drcli.base.files import decode, read_regular
from drcli.config import activation
from drcli.config.fields import GENERAL_RULE, file_problem, hidden, setting_problem
from drcli.config.value_types import FOLDER_NAME

EXPERIMENT = activation.EXPERIMENT

LARGEST_BYTES = 64 * 1024
"""A larger file was named by mistake."""

LONGEST_VALUE = 4096
"""Names that repeat each other must not fill the memory."""

DEEPEST_CHAIN = 20
LINE_END = re.compile(r"\r\n|\n|\r")

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_REFERENCE = re.compile(r"\\\$|\$\{(\w+)(?::-([^}]*))?\}|\$([A-Za-z_]\w*)", re.ASCII)


@dataclass(frozen=True)
class Entry:
    """One value without its quotes; `expands`: `$NAME` inside stands for another."""

    name: str
    value: str
    place: Place
    expands: bool


@dataclass(frozen=True)
class EnvFile:
    entries: tuple[Entry, ...]
    problems: tuple[Problem, ...]

    @property
    def last(self) -> dict[str, Entry]:
        """The last line of a name counts, as in a shell."""
        return {entry.name: entry for entry in self.entries}


def given(values: Mapping[str, str], source: str) -> dict[str, Entry]:
    """A layer from outside of the files."""
    return {name: Entry(name, value, Place(source), False) for name, value in values.items()}


def content_of(path: Path, name: str) -> bytes:
    """The bytes of a file.

    Raises:
        ProblemsError: It cannot be read.
    """
    try:
        return read_regular(path)
    except OSError as e:
        what = f"cannot be read ({e.strerror or e})."
        remedy = f"Check that {path} is a file and that you can read it."
        raise ProblemsError([file_problem(Place(name), what, remedy)]) from e


def text_of(data: bytes, name: str) -> str:
    """The text of a settings file: UTF-8 with or without a byte order mark.

    Raises:
        ProblemsError: The content is not text.
    """
    remedy = f"Save {name} as plain UTF-8 text, or restore it from your backup."
    text = decode(data, name, GENERAL_RULE, largest_bytes=LARGEST_BYTES, remedy=remedy)
    if "\0" in text:
        place = Place(name, text[: text.index("\0")].count("\n") + 1)
        raise ProblemsError(
            [file_problem(place, "contains a NUL byte, so it is not a text file.", remedy)]
        )
    return text


def parse_env(data: bytes, name: str) -> EnvFile:
    """Parse a settings file with any line ends.

    Raises:
        ProblemsError: The content is not text.
    """
    entries: list[Entry] = []
    problems: list[Problem] = []
    for binding in parse_stream(io.StringIO(text_of(data, name), newline="")):
        written = binding.original.string
        lead = written[: len(written) - len(written.lstrip())]
        place = Place(name, binding.original.line + len(LINE_END.findall(lead)))
        problem = _line_problem(binding, place)
        if problem is not None:
            problems.append(problem)
        elif binding.key is not None and binding.value is not None:
            quoted = written.partition("=")[2].lstrip().startswith("'")
            entries.append(Entry(binding.key, binding.value, place, expands=not quoted))
    return EnvFile(tuple(entries), tuple(problems))


def _line_problem(binding: Binding, place: Place) -> Problem | None:
    text = binding.original.string.strip()
    name = re.split(r"[=\s]", text.removeprefix("export "), maxsplit=1)[0]
    line = shown(name if hidden(name, text) != text else text)
    if binding.error:
        remedy = (
            "Write NAME=value, close every quote at the end of the value, "
            "and start comments with #."
        )
        return file_problem(place, f"{line} is not a NAME=value line.", remedy)
    if binding.key is None:
        return None
    if binding.value is None:
        remedy = "Write NAME=value, or start the line with # if it is a comment."
        return file_problem(place, f"{line} has no =.", remedy)
    if _NAME.fullmatch(binding.key):
        return None
    remedy = "Use only letters, digits and _ in the name, as in DR_WORKERS=1."
    return file_problem(place, f"{line} does not start with a variable name.", remedy)


class SettingsFiles:
    """The settings files of one folder; `contents` replace those on the disk."""

    def __init__(self, directory: Path, contents: Mapping[str, bytes] | None = None) -> None:
        self.directory = directory
        self.contents = contents or {}
        self.problems: list[Problem] = []
        """What is wrong or odd in the files that were read so far."""
        self.complete = True
        """Whether all of them could be read, apart from single lines."""

    def exist(self, name: str) -> bool:
        return name in self.contents or os.path.lexists(self.directory / name)

    def read(self, name: str) -> dict[str, Entry]:
        """The entries of a file; none where it cannot be read.

        Raises:
            ProblemsError: The file does not exist.
        """
        if not self.exist(name):
            what = f"there is no such file in {self.directory}."
            remedy = f"Change to the folder that holds {name}, or create one with `dr init`."
            raise ProblemsError([file_problem(Place(name), what, remedy)])
        try:
            data = self.contents.get(name)
            file = parse_env(
                content_of(self.directory / name, name) if data is None else data, name
            )
        except ProblemsError as error:
            self.complete = False
            file = EnvFile((), error.problems)
        self.problems += file.problems
        before: dict[str, Place] = {}
        places: dict[str, Place] = {}
        for entry in file.entries:
            if entry.name in places:
                before[entry.name] = places[entry.name]
            places[entry.name] = entry.place
        for key, place in before.items():
            what = f"{key} is also set at {place}; the later line counts."
            remedy = "Remove one of the lines."
            self.problems.append(
                setting_problem(key, places[key], what, remedy, severity="warning")
            )
        return file.last

    def run_file(self, outside: Sequence[Mapping[str, Entry]], experiment: str) -> str:
        if experiment:
            return f"experiments/{experiment}/run.env"
        values = {name: entry.value for layer in outside for name, entry in layer.items()}
        return activation.run_file(values, self.directory)

    def experiment(self, layers: Sequence[Mapping[str, Entry]]) -> str:
        """Name of the chosen experiment; run.env cannot choose itself.

        Raises:
            ProblemsError: There is no such experiment, or a file before it is wrong.
        """
        found = Layers(layers)
        name, entry = (found.text(EXPERIMENT) or "").strip(), found.find(EXPERIMENT)
        folders = (self.directory / "experiments").glob("*/run.env")
        existing = sorted(path.parent.name for path in folders)
        if not name or entry is None or name in existing:
            return name
        written = f"{EXPERIMENT}={shown(name)}"
        if FOLDER_NAME.fullmatch(name):
            what = f"{written} has no experiments/{name}/run.env in {self.directory}."
            new = f"Write it with `dr init --experiment {name}`"
        else:
            what, new = f"{written} is not a plain folder name.", "Name a folder in experiments/"
        remedy = one_of(existing, name) if existing else f"{new}, or drop the name."
        problem = setting_problem(EXPERIMENT, entry.place, what, remedy)
        raise ProblemsError([*self.problems, problem])


def references(value: str) -> set[str]:
    found = {match[1] or match[3] for match in _REFERENCE.finditer(value)}
    return found - {None}


class Layers:
    """Looks up names, the strongest layer first, defaults last."""

    def __init__(
        self, layers: Sequence[Mapping[str, Entry]], defaults: Mapping[str, str] | None = None
    ) -> None:
        self.problems: dict[str, Problem] = {}
        """Why the value of a name could not be filled in."""
        self.referenced: set[str] = set()
        """Names that some value refers to."""
        self._layers = layers
        self._defaults = defaults or {}
        self._known: dict[str, str] = {}

    def find(self, name: str) -> Entry | None:
        return next((layer[name] for layer in self._layers if name in layer), None)

    def text(self, name: str, trail: tuple[str, ...] = ()) -> str | None:
        """A value with everything filled in."""
        if name not in self._known:
            value = self._lookup(name, 0, trail)
            if value is None:
                return None
            self._known[name] = value
        return self._known[name]

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
                value = self._lookup(name, below, trail) if below < len(self._layers) else None
            elif name in trail or len(trail) > DEEPEST_CHAIN:
                self._reject(entry, f"refers to itself or through too many names ({name})")
                return ""
            else:
                value = self.text(name, trail)
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
            f"Set {missing} in system.env or in the environment, or write the value itself. "
            "In single quotes, a dollar sign stays as it is."
            if missing is not None
            else f"Write the value of {entry.name} itself."
        )
        what = f"{entry.name}={shown(entry.value)} {reason}."
        problem = setting_problem(entry.name, entry.place, what, remedy)
        self.problems.setdefault(entry.name, problem)
