"""Reads a racer's JSON file, and says what is wrong in which line."""

import json
import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, get_args

import yaml
from pydantic import BeforeValidator, ValidationError
from pydantic_core import ErrorDetails

from drcli.base.errors import BadValue, Problem, ProblemsError, Severity, closest, not_one_of, shown
from drcli.base.files import decode

KeyPath = tuple[str | int, ...]
LARGEST_BYTES = 1024 * 1024
"""A larger file is a mistake."""

LARGEST_NUMBER = 1e15

_REMEDY = "Compare it with the file of the same kind that `dr init` writes."

_SYNTAX = {
    "Expecting value": "a value is missing",
    "Expecting ',' delimiter": "a comma or a closing bracket is missing",
    "Expecting ':' delimiter": "a : is missing after the key",
    "Expecting property name enclosed in double quotes": (
        'a key in double quotes is missing, as in "lr": 0.0003, or there is a comma too many'
    ),
    "Unterminated string starting at": "a text in quotes is not complete",
    "Extra data": "there is something after the end",
}
"""In plain English."""

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\],:]|[^\s{}\[\],:"]+')


@dataclass(frozen=True)
class JsonFile:
    name: str
    values: dict[str, Any]
    lines: Mapping[KeyPath, int]

    def problem(
        self,
        rule: str,
        path: KeyPath,
        message: str,
        remedy: str,
        severity: Severity = "error",
        several: str = "",
    ) -> Problem:
        """In the line of the value, or of the closest thing around."""
        key = dotted(path)
        while path and path not in self.lines:
            path = path[:-1]
        line = self.lines[path] if path else None
        return Problem(rule, severity, self.name, line, message, remedy, key, several)


def read_json_object(data: bytes, name: str, rule: str) -> JsonFile:
    """Read an object in UTF-8, maybe with a byte order mark.

    Raises:
        ProblemsError: It is too large, not text, not JSON, not an object, or has a key twice.
    """

    def problem(line: int | None, message: str, remedy: str = _REMEDY) -> ProblemsError:
        return ProblemsError([Problem(rule, "error", name, line, message, remedy)])

    text = decode(data, name, rule, largest_bytes=LARGEST_BYTES, remedy=_REMEDY)
    if not text.strip():
        raise problem(None, "The file is empty.")
    correct = f"Correct that line. {_REMEDY}"
    try:
        values = json.loads(text)
    except json.JSONDecodeError as e:
        comment = text.startswith(("//", "/*", "#"), e.pos)
        what = "JSON has no comments" if comment else _SYNTAX.get(e.msg, e.msg)
        message = f"The file is not valid JSON at column {e.colno}: {what}."
        raise problem(e.lineno, message, correct) from e
    except RecursionError as e:
        raise problem(None, "The file is nested too deeply.") from e
    except ValueError as e:  # Python does not convert a number of 5,000 digits
        message = "The file is not valid JSON: a number has too many digits."
        raise problem(None, message) from e
    if not isinstance(values, dict):
        message = f"The file contains {shown(text.strip())} instead of a JSON object."
        raise problem(1, message, "Put the values between { and }.")
    lines, faults = _lines(text)
    for line, fault in faults:
        raise problem(line, f"The file is not valid JSON: {fault}.", correct)
    return JsonFile(name, values, lines)


def problems_of(
    error: ValidationError,
    file: JsonFile,
    rule_of: Callable[[KeyPath], str],
    examples: Mapping[str, Any],
) -> list[Problem]:
    """From pydantic, with rules by path; remedies name the examples."""
    found = []
    for details in error.errors(include_url=False):
        path, written = details["loc"], details["input"]
        reason, remedy = _explained(details, examples)
        value = "" if details["type"] == "missing" else f"={as_written(written)}"
        message = f"{dotted(path)}{value} {reason}."
        found.append(file.problem(rule_of(path), path, message, remedy))
    return found


def _explained(details: ErrorDetails, examples: Mapping[str, Any]) -> tuple[str, str]:
    path, written, context = details["loc"], details["input"], details.get("ctx", {})
    key = next(part for part in reversed(path) if isinstance(part, str))
    example = ""
    if key in examples:
        value = json.dumps(examples[key])
        example = f'"{key}": {value}' if path[-1] == key else value.strip("[]")
    such_as = f", as in {example}." if example else "."
    match details["type"]:
        case "value_error":
            bad = context["error"]
            return bad.reason, bad.remedy or f"Write {_as_number(written)}{such_as}"
        case "missing":
            meant = closest(key, written)
            rename = f'Rename "{shown(meant)}" to "{key}".' if meant is not None else ""
            return "is missing", rename or f"Add {example}."
        case "int_from_float":
            return "is not a whole number", f"Write a whole number{such_as}"
        case "greater_than_equal":
            return f"is below {context['ge']:g}", f"Write {context['ge']:g} or more{such_as}"
        case "less_than_equal":
            return f"is above {context['le']:g}", f"Write {context['le']:g} or less{such_as}"
        case "bool_type":
            return "is neither true nor false", "Write true or false, without quotes."
        case "list_type":
            return "is not a list", f"Write a list{such_as}"
        case "too_short":
            return "is empty", f"Write at least one{such_as}"
    return "is not an object with keys", f"Write it between {{ }}{such_as}"


def _as_number(written: Any) -> str:
    """What to write; only a number in quotes has quotes too many."""
    number = written.strip().replace(",", ".") if isinstance(written, str) else ""
    if not _NUMBER.fullmatch(number):
        return "a number"
    return f"{number}, with a point" if "," in written else f"{number} without quotes"


def _number(written: Any) -> Any:
    if isinstance(written, bool) or not isinstance(written, int | float):
        raise BadValue("is not a number", "")
    if abs(written) > LARGEST_NUMBER:
        raise BadValue("is far too large", "")
    return written


Number = Annotated[float, BeforeValidator(_number)]
Whole = Annotated[int, BeforeValidator(_number)]
"""64.0 counts."""


def choice(literal: Any, spellings: Mapping[str, str] | None = None) -> BeforeValidator:
    """A word of a `Literal` or of a table in any case, or another of its `spellings`."""

    def read(written: Any) -> str:
        words: Sequence[str] = get_args(literal) or tuple(literal)
        by_fold = {word.casefold(): word for word in words} | dict(spellings or {})
        folded = written.strip().casefold() if isinstance(written, str) else ""
        if folded not in by_fold:
            raise not_one_of(words, str(written))
        return by_fold[folded]

    return BeforeValidator(read)


def as_written(value: Any) -> str:
    return shown(json.dumps(value, ensure_ascii=False))


def dotted(path: KeyPath) -> str:
    """As a racer writes it: `action_space[2].speed`."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{shown(part)}" for part in path)
    return "".join(parts).removeprefix(".")


def _lines(text: str) -> tuple[dict[KeyPath, int], list[tuple[int, str]]]:
    lines: dict[KeyPath, int] = {}
    faults: list[tuple[int, str]] = []
    path: list[str | int | None] = []  # None where a key of an object comes next
    line, counted = 1, 0
    for token in _TOKEN.finditer(text):
        word = token[0]
        line, counted = line + text.count("\n", counted, token.start()), token.start()
        if word in "}]":
            path.pop()
        elif word == ",":
            last = path[-1]
            path[-1] = last + 1 if isinstance(last, int) else None
        elif path and path[-1] is None:
            path[-1] = json.loads(word)
            if tuple(path) in lines:
                faults.append((line, f"the key {shown(json.loads(word))} occurs twice"))
        elif word != ":":
            lines[tuple(part for part in path if part is not None)] = line
            if word in "{[":
                path.append(None if word == "{" else 0)
            elif word in ("NaN", "Infinity", "-Infinity"):
                faults.append((line, f"{word} is not a number in JSON"))
    return lines, faults


# Reads a racer's YAML file, with lines for messages.


LARGEST_YAML_BYTES = 256 * 1024
MOST_NODES = 20_000
"""Repeated anchors count each time."""


class _Loader(yaml.SafeLoader):
    """As JSON: a date stays a text, and 1e-4 is a number."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(":timestamp")]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(  # YAML 1.1 wants a dot in such a number
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+"), list("-+0123456789")
)


_KINDS = ("str", "int", "float", "bool", "null", "seq", "map", "merge")


def read_yaml_object(data: bytes, name: str, rule: str, key: str, remedy: str) -> JsonFile:
    """Messages name the most important `key`.

    Raises:
        ProblemsError: It is too large, not text, not YAML, not an object, or has a key twice.
    """

    def problem(line: int | None, message: str, how: str = remedy) -> ProblemsError:
        return ProblemsError([Problem(rule, "error", name, line, message, how)])

    text = decode(data, name, rule, largest_bytes=LARGEST_YAML_BYTES, remedy=remedy)
    if not text.strip():
        raise problem(None, "The file is empty.")
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        lines: dict[KeyPath, int] = {}
        faults: list[tuple[int, str]] = []
        if node is not None:
            _walk(node, (), lines, faults)
        values = None if node is None else loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        what = f"The file is not valid YAML: {error.problem or error.context}."
        raise problem(None if mark is None else mark.line + 1, what) from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        what = f"The file is not valid YAML: {shown(str(error).splitlines()[0])}."
        raise problem(None, what) from error
    except RecursionError as error:
        raise problem(None, "The file is nested too deeply, or refers to itself.") from error
    finally:
        loader.dispose()
    if faults:
        line, fault = faults[0]
        raise problem(line, fault)
    if not isinstance(values, dict):
        what = f"The file contains {shown(text.strip())} instead of the key {key}."
        raise problem(1, what)
    return JsonFile(name, values, lines)


def _walk(
    node: yaml.Node, path: KeyPath, lines: dict[KeyPath, int], faults: list[tuple[int, str]]
) -> None:
    if len(lines) > MOST_NODES:
        raise RecursionError
    lines[path] = node.start_mark.line + 1
    kind = node.tag.removeprefix("tag:yaml.org,2002:")
    if kind not in _KINDS:
        faults.append(
            (lines[path], f"A value has the type {shown(node.tag)}; write a plain value.")
        )
    elif kind == "float" and node.value.lstrip("+-").casefold() in (".inf", ".nan"):
        faults.append((lines[path], f"{shown(node.value)} is not a number."))
    if isinstance(node, yaml.SequenceNode):
        for index, child in enumerate(node.value):
            _walk(child, (*path, index), lines, faults)
    elif isinstance(node, yaml.MappingNode):
        seen: set[Hashable] = set()
        for key, child in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                faults.append((line, "A key is a list or an object; write a word."))
                continue
            if key.value in seen and key.value != "<<":
                faults.append((line, f"The key {shown(key.value)} occurs twice."))
            seen.add(key.value)
            _walk(child, (*path, key.value), lines, faults)
            lines[(*path, key.value)] = line
