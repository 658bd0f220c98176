"""Reads a racer's JSON file and remembers the line of each value, so that errors can name it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

from drcli.base.errors import SettingsError
from drcli.base.problems import shown
from drcli.base.text_file import decode

Path = tuple[str | int, ...]
"""Keys and indices that lead from the whole file to a value."""

LARGEST_BYTES = 1024 * 1024
"""No parameter file comes near this; a file beyond it was named by mistake."""

_SPACE = " \t\r\n"


@dataclass(frozen=True)
class JsonFile:
    """A file that holds one JSON object.

    Attributes:
        name: What to call it in messages.
        values: The object.
        lines: Line of each value inside, by its path.
    """

    name: str
    values: dict[str, Any]
    lines: Mapping[Path, int]

    def where(self, *path: str | int) -> str:
        """Place of a value, or of the closest thing around it that exists."""
        while path and path not in self.lines:
            path = path[:-1]
        return f"{self.name} line {self.lines[path]}" if path else self.name


def read_json_object(data: bytes, name: str) -> JsonFile:
    """Read a file that must hold one JSON object.

    Args:
        data: Content, UTF-8 with or without a byte order mark.
        name: What to call the file in messages.

    Raises:
        SettingsError: It is too large, no text, no JSON, no object, or holds a key twice.
    """
    text = decode(data, name, largest_bytes=LARGEST_BYTES, kind="parameter file", remedy=_REMEDY)
    if not text.strip():
        raise SettingsError(f"{name}: is empty.", remedy=_REMEDY)
    reader = _Reader(text, name)
    try:
        values = reader.read()
    except RecursionError as e:
        raise SettingsError(f"{name}: is nested too deeply.", remedy=_REMEDY) from e
    if not isinstance(values, dict):
        raise SettingsError(
            f"{name} line 1: holds {shown(text.strip())}, which is no JSON object.",
            remedy="Put the values between { and }.",
        )
    return JsonFile(name, values, reader.lines)


def as_written(value: Any) -> str:
    """A value of such a file as it may stand in a sentence, in the letters of its author."""
    return shown(json.dumps(value, ensure_ascii=False))


_REMEDY = "Compare it with the file of the same kind that `dr init` writes."


class _Reader:
    """A JSON parser: the library's own for single values, ours for what lies between them."""

    def __init__(self, text: str, name: str) -> None:
        self.lines: dict[Path, int] = {}
        self._text = text
        self._name = name
        self._decoder = json.JSONDecoder(parse_constant=self._refuse_constant)
        self._at = 0
        self._counted_to = 0
        self._line = 1

    def read(self) -> Any:
        value = self._value(())
        if self._peek():
            self._fail("there is something after the end")
        return value

    def _value(self, path: Path) -> Any:
        start = self._peek()
        self.lines[path] = self._current_line()
        if start == "{":
            return self._object(path)
        if start == "[":
            return self._array(path)
        try:
            value, self._at = self._decoder.raw_decode(self._text, self._at)
        except json.JSONDecodeError as e:
            self._at = e.pos
            quoted = e.msg.startswith(("Unterminated", "Invalid"))
            self._fail("a text in quotes is not complete" if quoted else "a value is missing")
        except ValueError:
            self._fail("the number has too many digits")
        return value

    def _object(self, path: Path) -> dict[str, Any]:
        values: dict[str, Any] = {}
        self._at += 1
        if self._peek() == "}":
            self._at += 1
            return values
        while True:
            if self._peek() != '"':
                self._fail('a key in double quotes is missing, as in "lr": 0.0003')
            key = self._value((*path, ""))
            if key in values:
                self._fail(f"the key {shown(key)} stands twice")
            self._expect(":", f"the : after {shown(key)} is missing")
            values[key] = self._value((*path, key))
            if self._ends("}", "a comma or } is missing"):
                return values
            if self._peek() == "}":
                self._fail("there is a comma before }")

    def _array(self, path: Path) -> list[Any]:
        values: list[Any] = []
        self._at += 1
        if self._peek() == "]":
            self._at += 1
            return values
        while True:
            values.append(self._value((*path, len(values))))
            if self._ends("]", "a comma or ] is missing"):
                return values

    def _ends(self, bracket: str, problem: str) -> bool:
        """Step over a bracket (True) or a comma (False)."""
        if self._peek() == bracket:
            self._at += 1
            return True
        self._expect(",", problem)
        return False

    def _expect(self, character: str, problem: str) -> None:
        if self._peek() != character:
            self._fail(problem)
        self._at += 1

    def _peek(self) -> str:
        """The next character that is no space; empty at the end."""
        while self._at < len(self._text) and self._text[self._at] in _SPACE:
            self._at += 1
        return self._text[self._at : self._at + 1]

    def _current_line(self) -> int:
        self._line += self._text.count("\n", self._counted_to, self._at)
        self._counted_to = self._at
        return self._line

    def _refuse_constant(self, word: str) -> NoReturn:
        self._fail(f"{word} is no number that JSON knows")

    def _fail(self, problem: str) -> NoReturn:
        line = self._text.count("\n", 0, self._at) + 1
        column = self._at - self._text.rfind("\n", 0, self._at)
        raise SettingsError(
            f"{self._name} line {line} column {column}: is no valid JSON, {problem}.",
            remedy=f"Correct that line. {_REMEDY}",
        )
