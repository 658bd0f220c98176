"""Checks reward_function.py without running it."""

import ast
import re
import warnings
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property

from drcli.base.errors import Problem, ProblemsError, Severity, closest
from drcli.base.files import decode
from drcli.base.installation import lazy_imports
from drcli.model.files.custom_files import InputFile
from drcli.rewards.reward_parameter_texts import REWARD_PARAMETERS
from drcli.rewards.sandbox.run_sandbox import REMEDIES

with lazy_imports():
    from pyflakes import checker as pyflakes_checker
    from pyflakes import messages as pyflakes_messages

# Finds conditions of a reward function that wait for step 0 or 1, which never comes.
#
# In step 1 the car is put on the road: the first call of an episode has `steps` 2, in training
# and evaluations. Source: the reference simulator, whose traces have a row of step 1 with reward
# 0.


FIRST = 2
_SAME_NUMBER = {"int", "float", "round"}
_TURNED: dict[type[ast.cmpop], ast.cmpop] = {
    ast.Lt: ast.Gt(),
    ast.LtE: ast.GtE(),
    ast.Gt: ast.Lt(),
    ast.GtE: ast.LtE(),
}


@dataclass(frozen=True)
class Idle:
    """A condition that is always true (`holds`), or never."""

    line: int
    text: str
    holds: bool

    @property
    def message(self) -> str:
        often = "always" if self.holds else "never"
        return (
            f"`{self.text}` is {often} true: the first call of an episode has `steps` {FIRST}. "
            "Step 1, in which the car is put on the road, earns no reward, here and in the "
            "reference simulator."
        )

    @property
    def remedy(self) -> str:
        if self.holds:
            return f"Write `steps > {FIRST}` for every call except the first of an episode."
        return f"Write `steps <= {FIRST}` for the first call of an episode."


def idle_conditions(tree: ast.Module) -> list[Idle]:
    """The comparisons of `steps` that have the same result in every call, by line.

    Guards against a division by zero, such as `steps > 0`, are fine. `steps` is recognised by names
    that only ever hold it, within a function.
    """
    try:
        found = {
            Idle(node.lineno, ast.unparse(node), outcome)
            for scope in _scopes(tree)
            for names in [_names_of_steps(scope)]
            for node in scope
            if isinstance(node, ast.expr)
            for outcome in _outcomes(node, names)
        }
    except RecursionError:
        return []
    return sorted(found, key=lambda idle: (idle.line, idle.text))


def _scopes(tree: ast.AST) -> Iterator[list[ast.AST]]:
    inside: list[ast.AST] = [tree]
    nodes: list[ast.AST] = []
    while inside:
        node = inside.pop()
        nodes.append(node)
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                yield from _scopes(child)
            else:
                inside.append(child)
    yield nodes


def _names_of_steps(scope: list[ast.AST]) -> set[str]:
    stored = Counter(
        node.arg if isinstance(node, ast.arg) else ast.unparse(node)
        for node in scope
        if isinstance(node, ast.arg) or isinstance(getattr(node, "ctx", None), ast.Store)
    )
    assigned = [pair for node in scope for pair in _assignments(node)]
    names: set[str] = set()
    while True:  # a name may be given another name for steps
        held = Counter(name for name, value in assigned if _is_steps(value, names))
        more = {name for name, times in held.items() if times == stored[name]}
        if more == names:
            return names
        names = more


def _assignments(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    match node:
        case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
            yield from zip(map(ast.unparse, targets), values, strict=False)
        case ast.Assign(targets=targets, value=value):
            yield from ((ast.unparse(target), value) for target in targets)
        case ast.AnnAssign(target=target, value=ast.expr() as value):
            yield ast.unparse(target), value
        case ast.NamedExpr(target=target, value=value):
            yield ast.unparse(target), value


def _is_steps(node: ast.expr, names: set[str]) -> bool:
    match node:
        case ast.Subscript(slice=ast.Constant(value=key)):
            return bool(key == "steps")
        case ast.Call(func=ast.Attribute(attr="get"), args=[ast.Constant(value=key), *_]):
            return bool(key == "steps")
        case ast.Call(func=ast.Name(id=name), args=[only]) if name in _SAME_NUMBER:
            return _is_steps(only, names)
        case ast.NamedExpr(value=value):
            return _is_steps(value, names)
        case ast.Name() | ast.Attribute():
            return ast.unparse(node) in names
    return False


def _outcomes(node: ast.expr, names: set[str]) -> Iterator[bool]:
    match node:
        case ast.UnaryOp(op=ast.Not(), operand=operand) if _is_steps(operand, names):
            yield False
        case ast.Compare(left=left, ops=ops, comparators=others):
            sides = [left, *others]
            for before, op, after in zip(sides, ops, others, strict=False):
                if _is_steps(before, names):
                    outcome = _compared(op, _numbers(after))
                elif _is_steps(after, names):
                    outcome = _compared(_TURNED.get(type(op), op), _numbers(before))
                else:
                    continue
                # In `1 < steps < 9` a part that is never true decides; one that always is does not.
                if outcome is False or (outcome and len(ops) == 1):
                    yield outcome


def _numbers(node: ast.expr) -> list[float]:
    try:
        value = ast.literal_eval(node)
    except (ValueError, TypeError):  # not a literal, or a list in a set
        return []
    values = list(value) if isinstance(value, tuple | list | set) else [value]
    return values if all(isinstance(number, int | float) for number in values) else []


def _compared(op: ast.cmpop, numbers: list[float]) -> bool | None:
    if not numbers:
        return None
    most = max(numbers)
    unreachable = all(number < FIRST or number % 1 for number in numbers)
    if isinstance(op, ast.Eq | ast.In | ast.Is) and unreachable:
        return False
    if isinstance(op, ast.NotEq | ast.NotIn | ast.IsNot) and unreachable and most > 0:
        return True
    if (isinstance(op, ast.Lt) and most <= FIRST) or (isinstance(op, ast.LtE) and most < FIRST):
        return False
    guarded = FIRST - 1 <= most < FIRST if isinstance(op, ast.Gt) else most == FIRST
    return True if isinstance(op, ast.Gt | ast.GtE) and guarded else None


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
    def words(self) -> frozenset[str]:
        """In quotes, and arguments of functions, so all parameters that it reads.

        As `drsim.episode.reward.names_in`, without loading the simulation.
        """
        nodes = list(ast.walk(self.tree))
        quoted = {str(node.value) for node in nodes if isinstance(node, ast.Constant)}
        return frozenset(quoted | {node.arg for node in nodes if isinstance(node, ast.arg)})

    @cached_property
    def unknown_parameters(self) -> dict[str, int]:
        arguments = {
            next((each.arg for each in function.args.args if each.arg != "self"), "")
            for function in ast.walk(self.tree)
            if isinstance(function, ast.FunctionDef) and function.name == "reward_function"
        }
        own: set[str] = set()  # that the file sets, or looks for before it reads them
        asked: dict[str, int] = {}
        for node in ast.walk(self.tree):
            match node:
                case ast.Subscript(value=ast.Name(id=name), slice=ast.Constant(value=str(key))):
                    if name in arguments and not isinstance(node.ctx, ast.Load):
                        own.add(key)
                    elif name in arguments:
                        asked.setdefault(key, node.lineno)
                case ast.Compare(
                    left=ast.Constant(value=str(key)),
                    ops=[ast.In() | ast.NotIn()],
                    comparators=[
                        ast.Name(id=name) | ast.Call(func=ast.Attribute(ast.Name(id=name)))
                    ],
                ) if name in arguments:
                    own.add(key)
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
        try:
            messages = pyflakes_checker.Checker(self.tree, filename=self.name).messages
        except RecursionError:  # pyflakes needs more depth than Python itself
            return ()
        return tuple(
            (
                each.lineno,
                each.message % each.message_args,
                isinstance(each, pyflakes_messages.UndefinedName),
            )
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
    """Mistakes that would only show during a training; `known`: names that are told elsewhere."""
    return [
        *_undefined_names(source, known),
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


def _undefined_names(source: Source, known: Collection[str]) -> Iterator[Problem]:
    """V-22."""
    reported = {f"undefined name {name!r}" for name in known}
    for line, text, undefined in source.flakes:
        if undefined and text not in reported:
            reported.add(text)
            what = f"{text}. A call that reaches this line fails."
            yield source.problem("V-22", line, what, REMEDIES["undefined"], "warning")


def is_undefined_name(problem: Problem) -> bool:
    return problem.rule == "V-22" and problem.remedy == REMEDIES["undefined"]


def _unknown_parameters(source: Source, known: Collection[str]) -> Iterator[Problem]:
    """V-22."""
    for name, line in source.unknown_parameters.items():
        if name not in known and not source.is_silenced(line):
            what = f"It reads `{name}`, which is not a parameter."
            yield source.problem("V-22", line, what, likely_parameter(name), "warning")


def likely_parameter(name: str) -> str:
    likely = closest(name, REWARD_PARAMETERS)
    return f"Did you mean `{likely}`?" if likely else "`dr docs reward-functions` lists them all."


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
