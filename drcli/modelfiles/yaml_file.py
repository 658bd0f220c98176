"""Reads a racer's YAML file, with lines for messages."""

import re
from collections.abc import Hashable

import yaml

from drcli.base.problems import Problem, ProblemsError, shown
from drcli.base.text_file import decode
from drcli.modelfiles.json_file import JsonFile, KeyPath

LARGEST_BYTES = 256 * 1024
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

    text = decode(data, name, rule, largest_bytes=LARGEST_BYTES, remedy=remedy)
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
