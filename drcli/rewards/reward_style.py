"""Checks style, and what the DeepRacer console forbids."""

import ast
import re
from collections.abc import Iterator
from dataclasses import replace

import pycodestyle

from drcli.base.errors import Problem, Severity
from drcli.rewards.reward_rules import Source

FUNCTION = "reward_function"

MODULES = ("math", "numpy", "random", "scipy", "shapely")
"""Allowed. Source: the console's validator."""

BUILTINS = ("open", "exec", "eval", "compile", "input", "__import__")
FILE_CALLS = re.compile(
    "__import__|fromfile|genfromtxt|loads?|loadtxt|memmap|save|savetxt|savez(_compressed)?|tofile"
)
IGNORED_STYLE = ("E5", "E226", "E261", "E9")
MOST_LINES = 5


def review_style(source: Source, *, console: bool) -> list[Problem]:
    """V-20, V-22 and V-23; errors if the console shall take the model.

    Remarks about style are of one kind, see `grouped`.
    """
    severity: Severity = "error" if console else "warning"
    remarks = (
        *_flakes(source, severity),
        *_style(source, severity),
        *_late_imports(source, severity),
    )
    found = [
        *_signature(source, severity),
        *(replace(each, several="remarks about style") for each in remarks),
    ]
    return [*found, *_imports(source), *_calls(source)] if console else found


def _signature(source: Source, severity: Severity) -> Iterator[Problem]:
    for node in source.tree.body:
        if not isinstance(node, ast.FunctionDef) or node.name != FUNCTION:
            continue
        a = node.args
        named = [*a.posonlyargs, *a.args]
        if len(named) == 1 and not (a.vararg or a.kwarg or a.kwonlyargs or a.defaults):
            continue
        needed = len(named) - len(a.defaults)
        if needed > 1 or any(default is None for default in a.kw_defaults):
            continue  # it cannot be called, which the sandbox reports
        what = f"{FUNCTION}({ast.unparse(a)}) takes more than one parameter."
        yield source.problem(
            "V-20", node.lineno, what, f"Write `def {FUNCTION}(params):`.", severity
        )


def _flakes(source: Source, severity: Severity) -> Iterator[Problem]:
    """V-22, class F."""
    for line, text, undefined in source.flakes:
        if not undefined:
            yield source.problem("V-22", line, f"{text}.", "Correct or remove it.", severity)


def _style(source: Source, severity: Severity) -> Iterator[Problem]:
    """V-22, class E."""
    messages: dict[str, list[int]] = {}

    # The type is ignored because pycodestyle has no types.
    class Messages(pycodestyle.BaseReport):  # type: ignore[misc]
        def error(self, line_number: int, offset: int, text: str, check: object) -> None:
            silent = text.startswith(IGNORED_STYLE) or source.is_silenced(line_number)
            if text.startswith("E") and not silent:
                messages.setdefault(text, []).append(line_number)

    style = pycodestyle.StyleGuide(reporter=Messages, ignore=list(IGNORED_STYLE))
    lines = source.text.splitlines(keepends=True)
    report = Messages(style.options)
    pycodestyle.Checker(source.name, lines, options=style.options, report=report).check_all()
    for text, numbers in messages.items():
        first, *others = sorted(set(numbers))
        also = ", ".join(map(str, others[: MOST_LINES - 1]))
        if len(others) >= MOST_LINES:
            also += f" and {len(others) + 1 - MOST_LINES} more"
        more = f" (also in {'lines' if len(others) > 1 else 'line'} {also})" if also else ""
        remedy = "Correct it, or end the line with `# noqa`."
        yield source.problem("V-22", first, f"{text}{more}.", remedy, severity)


def _late_imports(source: Source, severity: Severity) -> Iterator[Problem]:
    """V-22."""
    top = {id(node) for node in source.tree.body}
    for node in ast.walk(source.tree):
        if isinstance(node, ast.Import | ast.ImportFrom) and id(node) not in top:
            what = f"`{ast.unparse(node)}` is inside a function or block."
            remedy = "Move it to the top of the file."
            yield source.problem("V-22", node.lineno, what, remedy, severity)


def _imports(source: Source) -> Iterator[Problem]:
    for node in ast.walk(source.tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = ["." if node.level else str(node.module)]
        else:
            continue
        for name in names:
            if name.partition(".")[0] not in MODULES:
                what = f"imports {name}, which the console does not allow."
                yield source.problem(
                    "V-23", node.lineno, what, f"Import only {', '.join(MODULES)}."
                )


def _calls(source: Source) -> Iterator[Problem]:
    for node in ast.walk(source.tree):
        builtin = isinstance(node, ast.Name) and node.id in BUILTINS
        if builtin or (isinstance(node, ast.Attribute) and FILE_CALLS.fullmatch(node.attr)):
            what = f"uses {ast.unparse(node)}, which the console does not allow."
            remedy = "Remove it: reward functions there have no access to files."
            yield source.problem("V-23", getattr(node, "lineno", 1), what, remedy)
