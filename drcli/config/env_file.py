"""Reads and edits run.env and system.env: NAME=value lines, each with its place.

The lines are read, never executed. Values may hold spaces and `=`, may be in quotes, and `#`
after a space starts a comment. `$NAME` is left in place here; `drcli.config.layers` fills it in.
"""

import codecs
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dotenv.parser import Binding, parse_stream

from drcli.base.problems import Place, Problem, ProblemsError, shown
from drcli.base.text_file import decode
from drcli.config.setting_problems import GENERAL_RULE, file_problem

LARGEST_BYTES = 64 * 1024
"""A larger file was named by mistake."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_LINE_END = re.compile(r"\r\n|\n|\r")
_QUOTED = re.compile(r"""([^\S\r\n]*)(['"])((?:\\.|(?!\2)[^\\])*)\2(.*)""", re.DOTALL)
_BARE = re.compile(
    r"([^\S\r\n]*?)((?:\S[^\r\n]*?)?)((?:[^\S\r\n]+#[^\r\n]*)?[^\S\r\n]*(?:\r\n|\n|\r)?)"
)
"""What follows the =: space, value, and all that is behind it."""


@dataclass(frozen=True)
class Entry:
    """One value that somebody gave to a name, as written but without its quotes."""

    name: str
    value: str
    place: Place
    expands: bool
    """Whether `$NAME` inside stands for another value."""


@dataclass(frozen=True)
class EnvFile:
    """The entries of a file in their order, and the lines that could not be read."""

    entries: tuple[Entry, ...]
    problems: tuple[Problem, ...]


def read_env_file(path: Path, name: str) -> EnvFile:
    """Read a file that messages call by a name.

    Raises:
        ProblemsError: It cannot be opened or is not text.
    """
    return parse_env(content_of(path, name), name)


def content_of(path: Path, name: str) -> bytes:
    """The bytes of a file that messages call by a name.

    Raises:
        ProblemsError: It cannot be opened.
    """
    try:
        return path.read_bytes()
    except OSError as e:
        what = f"cannot be read ({e.strerror or e})."
        remedy = f"Check that {path} is a file and that you may read it."
        raise ProblemsError([file_problem(Place(name), what, remedy)]) from e


def parse_env(data: bytes, name: str) -> EnvFile:
    """Parse a settings file: UTF-8 with or without a byte order mark, any line ends.

    Raises:
        ProblemsError: The content is not text.
    """
    entries: list[Entry] = []
    problems: list[Problem] = []
    for binding in parse_stream(io.StringIO(_text(data, name), newline="")):
        written = binding.original.string
        lead = written[: len(written) - len(written.lstrip())]
        place = Place(name, binding.original.line + len(_LINE_END.findall(lead)))
        problem = _problem(binding, place)
        if problem is not None:
            problems.append(problem)
        elif binding.key is not None and binding.value is not None:
            quoted = written.partition("=")[2].lstrip().startswith("'")
            entries.append(Entry(binding.key, binding.value, place, expands=not quoted))
    return EnvFile(tuple(entries), tuple(problems))


def with_values(data: bytes, values: Mapping[str, str], name: str) -> bytes:
    """The content of a settings file with other values for some names.

    Everything else stays as it is: comments, order, quotes, line ends, byte order mark. Of a name
    that occurs twice the last line is changed, which is the one that counts; a new name gets a
    line at the end.

    Args:
        data: Content without problems.
        values: New values by name, without quotes or line breaks in them.
        name: What to call the file in messages.

    Raises:
        ProblemsError: The content is not text.
    """
    text = _text(data, name)
    bindings = list(parse_stream(io.StringIO(text, newline="")))
    lines = [binding.original.string for binding in bindings]
    places = {binding.key: index for index, binding in enumerate(bindings) if binding.key}
    ends = _LINE_END.search(text)
    end = ends[0] if ends is not None else "\n"
    for key, value in values.items():
        if key in places:
            lines[places[key]] = _line_with(lines[places[key]], value)
            continue
        if lines and not lines[-1].endswith(("\n", "\r")):
            lines[-1] += end
        lines.append(f"{key}={value}{end}")
    mark = codecs.BOM_UTF8 if data.startswith(codecs.BOM_UTF8) else b""
    return mark + "".join(lines).encode()


def with_any_value(data: bytes, key: str, value: str, name: str) -> bytes | None:
    """`with_values` for one value, in quotes where it needs them; a `$` in it keeps its meaning.

    Returns:
        None where quotes do not help, or the value is not text.

    Raises:
        ProblemsError: The content is not text.
    """
    wanted = {**{entry.name: entry.value for entry in parse_env(data, name).entries}, key: value}
    if any("\ud800" <= character <= "\udfff" for character in value):
        return None  # other bytes of a command line arrive as these
    for written in (value, f'"{value}"', f"'{value}'"):
        changed = with_values(data, {key: written}, name)
        after = {entry.name: entry for entry in parse_env(changed, name).entries}
        read = {entry.name: entry.value for entry in after.values()}
        if read == wanted and (after[key].expands or "$" not in value):
            return changed
    return None


def _line_with(line: str, value: str) -> str:
    """A NAME=value line with another value, in the quotes that it had."""
    head, equals, rest = line.partition("=")
    quoted = _QUOTED.fullmatch(rest)
    if quoted is not None:
        space, quote, _, behind = quoted.groups()
        return f"{head}{equals}{space}{quote}{value}{quote}{behind}"
    bare = _BARE.fullmatch(rest)
    space, behind = (bare[1], bare[3]) if bare is not None else ("", "")
    return f"{head}{equals}{space}{value}{behind}"


def _text(data: bytes, name: str) -> str:
    remedy = f"Save {name} as plain UTF-8 text, or restore it from your backup."
    text = decode(data, name, GENERAL_RULE, largest_bytes=LARGEST_BYTES, remedy=remedy)
    if "\0" in text:
        place = Place(name, text[: text.index("\0")].count("\n") + 1)
        raise ProblemsError([file_problem(place, "holds a NUL, so it is not text.", remedy)])
    return text


def _problem(binding: Binding, place: Place) -> Problem | None:
    """What is wrong with a line."""
    line = shown(binding.original.string.strip())
    if binding.error:
        return file_problem(
            place,
            f"{line} is not a NAME=value line.",
            "Write NAME=value, close every quote at the end of the value, "
            "and start comments with #.",
        )
    if binding.key is None:
        return None
    if binding.value is None:
        remedy = "Write NAME=value, or start the line with # if it is a comment."
        return file_problem(place, f"{line} has no =.", remedy)
    if not _NAME.fullmatch(binding.key):
        return file_problem(
            place,
            f"{line} does not start with a variable name.",
            "Use only letters, digits and _ in the name, as in DR_WORKERS=1.",
        )
    return None
