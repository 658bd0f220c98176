"""Checks reward_function.py without running it."""

import ast
import re
import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property

from drcli.base.problems import Problem, ProblemsError, Severity, closest
from drcli.base.text_file import decode
from drcli.explain.reward_parameter_texts import REWARD_PARAMETERS
from drcli.modelfiles.custom_files import InputFile
from drcli.rewards.sandbox.sandbox_records import REMEDIES
from drcli.rewards.step_conditions import idle_conditions

LARGEST_BYTES = 1024 * 1024
_ELSE_IF = re.compile(r"^\s*else\s+if\b")
_SILENCED = re.compile(r"#\s*noqa\b", re.IGNORECASE)


@dataclass(frozen=True)
class Source:
    """A reward function that compiles."""

    name: str
    data: bytes
    text: str
    tree: ast.Module

    def problem(
        self, rule: str, line: int | None, message: str, remedy: str, severity: Severity = "error"
    ) -> Problem:
        return Problem(rule, severity, self.name, line, message, remedy)

    def is_silenced(self, line: int) -> bool:
        """By `# noqa`."""
        lines = self.text.splitlines()
        return 0 < line <= len(lines) and _SILENCED.search(lines[line - 1]) is not None

    @cached_property
    def unknown_parameters(self) -> dict[str, int]:
        arguments = {
            next((each.arg for each in function.args.args if each.arg != "self"), "")
            for function in ast.walk(self.tree)
            if isinstance(function, ast.FunctionDef) and function.name == "reward_function"
        }
        own: set[str] = set()
        asked: dict[str, int] = {}
        for node in ast.walk(self.tree):
            match node:
                case ast.Subscript(value=ast.Name(id=name), slice=ast.Constant(value=str(key))):
                    if name in arguments and not isinstance(node.ctx, ast.Load):
                        own.add(key)
                    elif name in arguments:
                        asked.setdefault(key, node.lineno)
                case ast.Call(
                    func=ast.Attribute(value=ast.Name(id=name), attr="get"),
                    args=[ast.Constant(value=str(key)), *_],
                ) if name in arguments:
                    asked.setdefault(key, node.lineno)
        known = REWARD_PARAMETERS.keys() | own
        return {key: line for key, line in asked.items() if key not in known}

    @cached_property
    def flakes(self) -> tuple[tuple[int, str, bool], ...]:
        """Line, text, whether a name is undefined."""
        from pyflakes.checker import Checker
        from pyflakes.messages import UndefinedName

        try:
            messages = Checker(self.tree, filename=self.name).messages
        except RecursionError:  # pyflakes needs more depth than Python itself
            return ()
        return tuple(
            (each.lineno, each.message % each.message_args, isinstance(each, UndefinedName))
            for each in messages
            if not self.is_silenced(each.lineno)
        )


def read_source(file: InputFile) -> tuple[Source | None, list[Problem]]:
    """V-02 and, for `else if`, V-24."""
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
    return Source(name, file.data, text, tree), []


def review_source(source: Source, known: Collection[str] = ()) -> list[Problem]:
    """Mistakes that would only show during a training."""
    return [
        *_undefined_names(source),
        *_unknown_parameters(source, known),
        *_progress_of_one(source),
        *_first_steps(source),
    ]


def _uncompilable(error: Exception, name: str, text: str) -> Problem:
    line = error.lineno if isinstance(error, SyntaxError) else None
    what = error.msg if isinstance(error, SyntaxError) else str(error) or type(error).__name__
    lines = text.splitlines()
    shown = lines[line - 1] if line is not None and 0 < line <= len(lines) else ""
    quoted = f"\n  {shown.strip()}" if shown.strip() else ""
    if _ELSE_IF.match(shown):
        message = f"`else if` is not valid Python.{quoted}"
        return Problem("V-24", "error", name, line, message, "Write `elif` and the condition.")
    message = f"The reward function is not valid Python: {what}.{quoted}"
    remedy = "Correct that line." if line is not None else "Correct the file."
    return Problem("V-02", "error", name, line, message, remedy)


def _undefined_names(source: Source) -> Iterator[Problem]:
    """V-22."""
    reported: set[str] = set()
    for line, text, undefined in source.flakes:
        if undefined and text not in reported:
            reported.add(text)
            yield source.problem("V-22", line, f"{text}.", REMEDIES["undefined"])


def _unknown_parameters(source: Source, known: Collection[str]) -> Iterator[Problem]:
    """V-22."""
    for name, line in source.unknown_parameters.items():
        if name not in known and not source.is_silenced(line):
            what = f"It reads `{name}`, which is not a parameter."
            yield source.problem("V-22", line, what, likely_parameter(name), "warning")


def likely_parameter(name: str) -> str:
    likely = closest(name, REWARD_PARAMETERS)
    return f"Did you mean `{likely}`?" if likely else "docs/reward-functions.md lists all of them."


def _progress_of_one(source: Source) -> Iterator[Problem]:
    """V-24: `progress == 1`, as the console's guide once wrote."""
    for node in ast.walk(source.tree):
        if not isinstance(node, ast.Compare) or not isinstance(node.ops[0], ast.Eq):
            continue
        sides = [node.left, node.comparators[0]]
        if any(map(_is_progress, sides)) and any(map(_is_one, sides)):
            what = "progress == 1 is true for one moment at 1 % of the lap, if at all."
            remedy = "Write `progress >= 100` for a complete lap: progress runs from 0 to 100."
            yield source.problem("V-24", node.lineno, what, remedy, "warning")


def _first_steps(source: Source) -> Iterator[Problem]:
    """V-24."""
    for idle in idle_conditions(source.tree):
        if not source.is_silenced(idle.line):
            yield source.problem("V-24", idle.line, idle.message, idle.remedy, "warning")


def _is_progress(node: ast.expr) -> bool:
    if isinstance(node, ast.Subscript):
        node = node.slice
    name = getattr(node, "id", None) or getattr(node, "value", None)
    return name == "progress"


def _is_one(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) is not bool and node.value == 1
