"""Finds conditions of a reward function that wait for step 0 or 1, which never comes.

In step 1 the car is put on the road: the first call of an episode has `steps` 2, in training and
evaluations. Source: the reference simulator, whose traces have a row of step 1 with reward 0.
"""

import ast
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

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
