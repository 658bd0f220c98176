"""reward_function.py as it is written: what can be said about it without running it."""

import ast
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

from drcli.base.problems import Place, Problem, ProblemsError
from drcli.base.text_file import decode
from drcli.checks.first_step import idle_conditions
from drcli.modelfiles.custom_files import InputFile

LARGEST_BYTES = 1024 * 1024
"""No reward function comes near this; a file beyond it was named by mistake."""

_ELSE_IF = re.compile(r"^\s*else\s+if\b")
_SILENCED = re.compile(r"#\s*noqa\b", re.IGNORECASE)


@dataclass(frozen=True)
class Source:
    """A reward function that compiles.

    Attributes:
        name: What to call the file in messages.
        text: Its content.
        tree: The same taken apart.
    """

    name: str
    text: str
    tree: ast.Module

    def at(self, line: int) -> Place:
        """A place in the file."""
        return Place(self.name, line)

    def is_silenced(self, line: int) -> bool:
        """Whether a comment on that line asks not to be told about it."""
        lines = self.text.splitlines()
        return 0 < line <= len(lines) and _SILENCED.search(lines[line - 1]) is not None


def read_source(file: InputFile) -> tuple[Source | None, list[Problem]]:
    """Compile a reward function: rules V-02 and, where that fails for it, V-24."""
    name = file.origin
    remedy = f"Save {file.name} as plain UTF-8 text."
    try:
        text = decode(file.data, name, "V-02", largest_bytes=LARGEST_BYTES, remedy=remedy)
    except ProblemsError as error:
        return None, list(error.problems)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "is" with a number and the like belong to V-22
            tree = ast.parse(text)
            compile(text, name, "exec")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        return None, [_uncompilable(error, name, text)]
    return Source(name, text, tree), []


def review_source(source: Source) -> list[Problem]:
    """Rules whose breach shows while a training runs: undefined names, idle conditions."""
    return [
        *_undefined_names(source),
        *_progress_of_one(source.tree, source),
        *_first_steps(source),
    ]


def _uncompilable(error: Exception, name: str, text: str) -> Problem:
    line = error.lineno if isinstance(error, SyntaxError) else None
    what = error.msg if isinstance(error, SyntaxError) else str(error) or type(error).__name__
    lines = text.splitlines()
    shown = lines[line - 1] if line is not None and 0 < line <= len(lines) else ""
    quoted = f"\n  {shown.strip()}" if shown.strip() else ""
    if _ELSE_IF.match(shown):
        return Problem(
            "V-24",
            "error",
            name,
            line,
            f"`else if` is not valid Python.{quoted}",
            "Write `elif` and the condition.",
        )
    return Problem(
        "V-02",
        "error",
        name,
        line,
        f"The reward function is not valid Python: {what}.{quoted}",
        f"Correct {name}; nothing was started.",
    )


def _undefined_names(source: Source) -> Iterator[Problem]:
    """V-22: a name that nothing defines fails once its line is reached, maybe hours later."""
    from pyflakes.checker import Checker
    from pyflakes.messages import UndefinedName

    said: set[str] = set()
    for message in Checker(source.tree, filename=source.name).messages:
        if not isinstance(message, UndefinedName) or source.is_silenced(message.lineno):
            continue
        text = message.message % message.message_args
        if text not in said:
            said.add(text)
            yield Problem(
                "V-22",
                "error",
                *source.at(message.lineno),
                f"{text}.",
                "Correct the name, or give it a value before that line.",
            )


def _progress_of_one(tree: ast.Module, source: Source) -> Iterator[Problem]:
    """V-24: `progress == 1`, as the console's guide once wrote."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Compare) or not isinstance(node.ops[0], ast.Eq):
            continue
        sides = [node.left, node.comparators[0]]
        if any(map(_is_progress, sides)) and any(map(_is_one, sides)):
            yield Problem(
                "V-24",
                "warning",
                *source.at(node.lineno),
                "progress == 1 is true for a moment at 1 % of the lap, if ever.",
                "Write `progress >= 100` for a complete lap: progress runs from 0 to 100.",
            )


def _first_steps(source: Source) -> Iterator[Problem]:
    """V-24: a step before the first one that is paid."""
    for idle in idle_conditions(source.text):
        if not source.is_silenced(idle.line):
            where = source.at(idle.line)
            yield Problem("V-24", "warning", *where, idle.message, idle.remedy)


def _is_progress(node: ast.expr) -> bool:
    if isinstance(node, ast.Subscript):
        node = node.slice
    name = getattr(node, "id", None) or getattr(node, "value", None)
    return name == "progress"


def _is_one(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) is not bool and node.value == 1
