"""Finds conditions of a reward function on a first step that it is never called for.

In step 1 the car is put on the road, and the function is not called: the first call of an episode
has `steps` 2, in training and in evaluations. Source: the reference simulator, in whose traces each
episode has a row of step 1 with reward 0. Many published functions still wait for step 0 or 1.
"""

import ast
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

FIRST = 2
"""What `steps` is in the first call of an episode."""

_SAME_NUMBER = {"int", "float", "round"}
"""Calls that do not change a whole number."""

_TURNED: dict[type[ast.cmpop], ast.cmpop] = {
    ast.Lt: ast.Gt(),
    ast.LtE: ast.GtE(),
    ast.Gt: ast.Lt(),
    ast.GtE: ast.LtE(),
}
"""The same comparison with its sides swapped."""


@dataclass(frozen=True)
class Idle:
    """A condition that is the same in every call: always true (it `holds`), or never."""

    line: int
    text: str
    holds: bool
    """Whether it is always true; else it never is."""

    @property
    def message(self) -> str:
        """What is wrong with it, two sentences."""
        often = "always" if self.holds else "never"
        return (
            f"`{self.text}` is {often} true: the first call of an episode has `steps` {FIRST}. "
            "Step 1, in which the car is put on the road, earns no reward, here and in the "
            "reference simulator."
        )

    @property
    def remedy(self) -> str:
        """What to do about it."""
        if self.holds:
            return f"Write `steps > {FIRST}` for every call except the first of an episode."
        return f"Write `steps <= {FIRST}` for the first call of an episode."


def idle_conditions(text: str | bytes) -> list[Idle]:
    """The comparisons of `steps` with a number that have the same result in every call, by line.

    Guards against a division by zero, such as `steps > 0`, are not among them. `steps` is
    recognised where it is read from the parameters, and by a name that only ever holds it; values
    that one function passes to another are not followed.

    The text may be bytes; what is not Python has no conditions.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text)
        found = {
            Idle(node.lineno, ast.unparse(node), outcome)
            for scope in _scopes(tree)
            for names in [_names_of_steps(scope)]
            for node in scope
            if isinstance(node, ast.expr)
            for outcome in _outcomes(node, names)
        }
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return []
    return sorted(found, key=lambda idle: (idle.line, idle.text))


def _scopes(tree: ast.AST) -> Iterator[list[ast.AST]]:
    """The nodes of the file and of each function, without those of inner functions."""
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
    """Names and attributes that hold `steps` and nothing else in a scope."""
    given: dict[str, list[ast.expr | None]] = {}
    for node in scope:
        for target, value in _assignments(node):
            given.setdefault(ast.unparse(target), []).append(value)
    names: set[str] = set()
    while True:  # a name may be given another name for steps
        more = {
            name
            for name, values in given.items()
            if all(value is not None and _is_steps(value, names) for value in values)
        }
        if more == names:
            return names
        names = more


def _assignments(node: ast.AST) -> Iterator[tuple[ast.AST, ast.expr | None]]:
    """What a node assigns to what; None where the value has no expression of its own."""
    match node:
        case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)) if len(
            names
        ) == len(values):
            yield from zip(names, values, strict=True)
        case ast.Assign(targets=targets, value=value):
            for target in targets:
                if isinstance(target, ast.Tuple | ast.List):
                    yield from ((name, None) for name in target.elts)
                else:
                    yield target, value
        case ast.AnnAssign(target=target, value=value) | ast.NamedExpr(target=target, value=value):
            yield target, value
        case ast.AugAssign(target=target) | ast.For(target=target):
            yield target, None
        case ast.comprehension(target=target):
            yield target, None
        case ast.arg(arg=name):
            yield ast.Name(name), None


def _is_steps(node: ast.expr, names: set[str]) -> bool:
    """Whether an expression is the parameter `steps`."""
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
    """The result of a condition, where it is always the same."""
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
    """The number, or the numbers in brackets, that an expression is; empty for anything else."""
    try:
        value = ast.literal_eval(node)
    except ValueError:
        return []
    values = list(value) if isinstance(value, tuple | list | set) else [value]
    return values if all(isinstance(number, int | float) for number in values) else []


def _compared(op: ast.cmpop, numbers: list[float]) -> bool | None:
    """How the steps of an episode compare with numbers; None where that depends on the step."""
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
