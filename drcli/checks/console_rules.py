"""reward_function.py as the DeepRacer console wants it: signature, style, imports, calls."""

import ast
from collections.abc import Iterator

from drcli.base.problems import Problem, Severity
from drcli.checks.reward_rules import Source

FUNCTION = "reward_function"

MODULES = frozenset({"math", "random", "numpy", "scipy", "shapely"})
"""What may be imported there. Source: the console's validator."""

BUILTINS = frozenset({"open", "exec", "eval", "compile", "input", "__import__"})
"""What may not be called there. Source: the console's validator."""

FILE_CALLS = frozenset(
    {
        "__import__",
        "fromfile",
        "genfromtxt",
        "load",
        "loads",
        "loadtxt",
        "memmap",
        "save",
        "savetxt",
        "savez",
        "savez_compressed",
        "tofile",
    }
)
"""Ways to files inside those modules. Source: the console's validator."""

UNTOLD = ("E5", "E226", "E261", "E9")
"""Style that nobody is told about: line lengths and spaces round signs and before comments. Source:
the console's validator. E9 is about text that does not compile, which is V-02."""

_MENDING = {
    "E12": "Align the line with what stands in the bracket above it, or indent it by four blanks",
    "E13": "Align the line with what stands in the bracket above it, or indent it by four blanks",
    "E1": "Indent by four blanks a level, without tabs",
    "E2": "Correct the blanks",
    "E3": "Correct the number of blank lines",
    "E401": "Write each import on a line of its own",
    "E402": "Move the import to the top of the file",
    "E701": "Put what follows the colon on a line of its own",
    "E702": "Put each statement on a line of its own",
    "E703": "Remove the semicolon",
    "E704": "Put what follows the colon on a line of its own",
    "E71": "Write the comparison as the remark says",
    "E721": "Compare types with `is`, or call `isinstance`",
    "E722": "Write `except Exception:`",
    "E731": "Write a `def`",
    "E74": "Choose a longer name",
}
"""How remarks on style are mended, by the start of their code."""

MOST_LINES = 5
"""Lines that a remark on style names."""


def review_style(source: Source, *, console: bool) -> list[Problem]:
    """Rules V-20, V-22 and V-23; breaches are errors where the console shall take the model."""
    severity: Severity = "error" if console else "warning"
    found = [
        *_signature(source, severity),
        *_flakes(source, severity),
        *_style(source, severity),
        *_late_imports(source, severity),
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
            continue  # it cannot be called, which the trial says
        yield Problem(
            "V-20",
            severity,
            *source.at(node.lineno),
            f"{FUNCTION}({ast.unparse(a)}) takes more than its one parameter.",
            f"Write `def {FUNCTION}(params):`.",
        )


def _flakes(source: Source, severity: Severity) -> Iterator[Problem]:
    """V-22, class F, but for the undefined names, which are errors everywhere."""
    from pyflakes.checker import Checker
    from pyflakes.messages import UndefinedName

    for message in Checker(source.tree, filename=source.name).messages:
        if isinstance(message, UndefinedName) or source.is_silenced(message.lineno):
            continue
        text = message.message % message.message_args
        yield Problem(
            "V-22", severity, *source.at(message.lineno), f"{text}.", "Correct or remove it."
        )


def _style(source: Source, severity: Severity) -> Iterator[Problem]:
    """V-22, class E: each remark once, with the lines it is about."""
    import pycodestyle

    remarks: dict[str, list[int]] = {}

    class Remarks(pycodestyle.BaseReport):  # type: ignore[misc]
        def error(self, line_number: int, offset: int, text: str, check: object) -> None:
            if text.startswith("E") and not text.startswith(UNTOLD):
                remarks.setdefault(text, []).append(line_number)

    style = pycodestyle.StyleGuide(reporter=Remarks, ignore=list(UNTOLD))
    lines = source.text.splitlines(keepends=True)
    pycodestyle.Checker(
        source.name, lines=lines, options=style.options, report=Remarks(style.options)
    ).check_all()
    for text, numbers in remarks.items():
        told = sorted({number for number in numbers if not source.is_silenced(number)})
        if not told:
            continue
        more = ", ".join(map(str, told[1:MOST_LINES]))
        rest = f" and {len(told) - MOST_LINES} more" if len(told) > MOST_LINES else ""
        also = f" (also in {'lines' if len(told) > 2 else 'line'} {more}{rest})" if more else ""
        yield Problem(
            "V-22",
            severity,
            *source.at(told[0]),
            f"{text}{also}.",
            f"{_mending(text)}, or end the line with `# noqa`.",
        )


def _mending(remark: str) -> str:
    """How to mend a remark on style, as the start of a sentence."""
    return next((text for code, text in _MENDING.items() if remark.startswith(code)), "Correct it")


def _late_imports(source: Source, severity: Severity) -> Iterator[Problem]:
    """V-22: imports belong to the top of the file."""
    top = {id(node) for node in source.tree.body}
    for node in ast.walk(source.tree):
        if isinstance(node, ast.Import | ast.ImportFrom) and id(node) not in top:
            yield Problem(
                "V-22",
                severity,
                *source.at(node.lineno),
                f"`{ast.unparse(node)}` stands inside a function or block.",
                "Move it to the top of the file.",
            )


def _imports(source: Source) -> Iterator[Problem]:
    for node in ast.walk(source.tree):
        if not isinstance(node, ast.Import | ast.ImportFrom):
            continue
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            names = ["." if node.level else str(node.module)]
        for name in names:
            if name.partition(".")[0] not in MODULES:
                yield Problem(
                    "V-23",
                    "error",
                    *source.at(node.lineno),
                    f"imports {name}, which the console does not allow.",
                    f"Import only {', '.join(sorted(MODULES))}.",
                )


def _calls(source: Source) -> Iterator[Problem]:
    for node in ast.walk(source.tree):
        builtin = isinstance(node, ast.Name) and node.id in BUILTINS
        if builtin or (isinstance(node, ast.Attribute) and node.attr in FILE_CALLS):
            yield Problem(
                "V-23",
                "error",
                *source.at(getattr(node, "lineno", 1)),
                f"uses {ast.unparse(node)}, which the console does not allow.",
                "Do without it: reward functions there reach no files.",
            )
