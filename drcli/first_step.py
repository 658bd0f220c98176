"""Conditions of a reward function that wait for a first step it is never told of.

The car is put on the road in step 1, which is not paid: the first call of an episode has `steps` 2,
in training and in evaluations. Source: the reference simulator, in whose traces each episode has a
row of step 1 with reward 0. Many published functions ask for step 0 or 1 all the same.
"""

import ast
import itertools
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

FIRST = 2
"""What `steps` is in the first call of an episode."""

_PARAMETER = "steps"
_SAME_NUMBER = {"int", "float", "round"}
"""Calls that leave a whole number what it is."""

_Scope = ast.AST
_Value = tuple[ast.expr | None, _Scope]
"""What is assigned, or None where that is not known, and where it stands."""


@dataclass(frozen=True)
class Idle:
    """A condition that is the same in every call.

    Attributes:
        line: Where it stands.
        text: The condition, as Python writes it.
        holds: Whether it is always true; else it never is.
    """

    line: int
    text: str
    holds: bool

    @property
    def message(self) -> str:
        """What is the matter with it, two sentences."""
        often = "always" if self.holds else "never"
        return (
            f"`{self.text}` is {often} true: the first call of an episode has `steps` {FIRST}. "
            "Step 1, in which the car is put on the road, is not paid, here and on the reference "
            "simulator."
        )

    @property
    def remedy(self) -> str:
        """What to do about it."""
        if self.holds:
            return f"Write `steps > {FIRST}` for every call but the first of an episode."
        return f"Write `steps <= {FIRST}` for the first call of an episode."


def idle_conditions(text: str | bytes) -> list[Idle]:
    """The comparisons of `steps` with a number that come out the same in every call, by line.

    Guards against a division by nothing, such as `steps > 0`, are none of them.

    Args:
        text: A reward function, or the bytes of its file; what is no Python has no conditions.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text)
        names = _Names(tree)
        found = {
            Idle(node.lineno, ast.unparse(node), holds)
            for node, scope in names.expressions
            for holds in _outcomes(node, scope, names)
        }
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return []
    return sorted(found, key=lambda idle: (idle.line, idle.text))


def _outcomes(node: ast.expr, scope: _Scope, names: "_Names") -> Iterator[bool]:
    """What a condition always comes out as, where it is one that always does."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        if names.is_steps(node.operand, scope):
            yield False
    elif isinstance(node, ast.Compare):
        sides = [node.left, *node.comparators]
        for (left, right), op in zip(itertools.pairwise(sides), node.ops, strict=True):
            if names.is_steps(left, scope):
                outcome = _compared(op, names.numbers(right, scope))
            elif names.is_steps(right, scope):
                outcome = _compared(_TURNED.get(type(op), op), names.numbers(left, scope))
            else:
                continue
            # Of a chain such as `1 < steps < 9` one part that never holds decides, the rest do not.
            if outcome is False or (outcome is True and len(node.ops) == 1):
                yield outcome


_TURNED: dict[type[ast.cmpop], ast.cmpop] = {
    ast.Lt: ast.Gt(),
    ast.LtE: ast.GtE(),
    ast.Gt: ast.Lt(),
    ast.GtE: ast.LtE(),
}
"""The same comparison with its sides exchanged."""


def _compared(op: ast.cmpop, numbers: list[float]) -> bool | None:
    """How a step of an episode compares with numbers; None where that depends on the step."""
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


class _Names:
    """Which names and attributes of a file stand for `steps`, and which for a number.

    A name counts only if everything that the file assigns to it does.

    Attributes:
        expressions: Every expression of the file, with the function or file it belongs to.
    """

    def __init__(self, tree: ast.Module) -> None:
        self.expressions: list[tuple[ast.expr, _Scope]] = []
        self._tree = tree
        self._outer: dict[_Scope, _Scope] = {}
        self._values: dict[tuple[_Scope, str], list[_Value]] = {}
        self._attributes: dict[str, list[_Value]] = {}
        self._global: set[tuple[_Scope, str]] = set()
        self._functions: dict[str, list[ast.FunctionDef]] = {}
        self._calls: list[tuple[ast.Call, _Scope]] = []
        self._steps: set[tuple[_Scope, str]] = set()
        self._steps_attributes: set[str] = set()
        self._read(tree, tree, in_class=False)
        self._bind_arguments()
        while self._learn():
            pass

    def is_steps(self, node: ast.expr, scope: _Scope) -> bool:
        """Whether an expression is the parameter `steps`."""
        match node:
            case ast.Subscript(slice=ast.Constant(value=key)):
                return bool(key == _PARAMETER)
            case ast.Call(func=ast.Attribute(attr="get"), args=[ast.Constant(value=key), *_]):
                return bool(key == _PARAMETER)
            case ast.Call(func=ast.Name(id=name), args=[only]) if name in _SAME_NUMBER:
                return self.is_steps(only, scope)
            case ast.NamedExpr(value=value):
                return self.is_steps(value, scope)
            case ast.Attribute(attr=name):
                return name in self._steps_attributes
            case ast.Name(id=name):
                return (self._home(name, scope), name) in self._steps
        return False

    def numbers(self, node: ast.expr, scope: _Scope) -> list[float]:
        """The number or numbers that an expression always is; none where it is anything else."""
        if isinstance(node, ast.Tuple | ast.List | ast.Set):
            each = [self.numbers(item, scope) for item in node.elts]
            return [number for numbers in each for number in numbers] if all(each) else []
        if isinstance(node, ast.Name):
            values = self._values.get((self._home(node.id, scope), node.id), [])
            known = values[0][0] if len(values) == 1 else None
            node = known if isinstance(known, ast.Constant) else node
        try:
            number = ast.literal_eval(node)
        except ValueError:
            return []
        return [float(number)] if isinstance(number, int | float) else []

    def _home(self, name: str, scope: _Scope) -> _Scope:
        """Where a name that is used in a scope was assigned."""
        while (scope, name) not in self._values and scope in self._outer:
            scope = self._outer[scope]
        return scope

    def _learn(self) -> bool:
        """Find further names for `steps`; whether there were any."""
        before = len(self._steps) + len(self._steps_attributes)
        self._steps |= {key for key, values in self._values.items() if self._all_steps(values)}
        self._steps_attributes |= {
            name for name, values in self._attributes.items() if self._all_steps(values)
        }
        return len(self._steps) + len(self._steps_attributes) > before

    def _all_steps(self, values: list[_Value]) -> bool:
        return all(node is not None and self.is_steps(node, scope) for node, scope in values)

    def _read(self, node: ast.AST, scope: _Scope, *, in_class: bool) -> None:
        """Take note of what a part of the file assigns and calls, and of what lies within it."""
        if isinstance(node, ast.expr):
            self.expressions.append((node, scope))
        match node:
            case ast.Assign(targets=targets, value=value):
                for target in targets:
                    self._assign(target, value, scope, in_class=in_class)
            case ast.AnnAssign(target=target, value=value):
                self._assign(target, value, scope, in_class=in_class)
            case ast.NamedExpr(target=target, value=value):
                self._assign(target, value, scope, in_class=in_class)
            case ast.AugAssign(target=target) | ast.For(target=target):
                self._assign(target, None, scope, in_class=in_class)
            case (
                ast.comprehension(target=target) | ast.withitem(optional_vars=ast.expr() as target)
            ):
                self._assign(target, None, scope, in_class=in_class)
            case ast.Global(names=shared):
                self._global |= {(scope, name) for name in shared}
            case ast.Nonlocal(names=shared):
                for name in shared:  # assigned elsewhere too: not followed
                    self._assign(ast.Name(name), None, scope, in_class=False)
            case ast.Call():
                self._calls.append((node, scope))
            case ast.FunctionDef():
                self._functions.setdefault(node.name, []).append(node)
        inner = scope
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            self._outer[node] = scope
            inner, in_class = node, False
            a = node.args
            others = [*a.posonlyargs, *a.kwonlyargs, a.vararg, a.kwarg]
            if not isinstance(node, ast.FunctionDef):  # whose calls are not followed
                others += a.args
            for argument in others:
                if argument is not None:
                    self._bind(node, argument.arg, None)
        elif isinstance(node, ast.ClassDef):
            in_class = True
        for child in ast.iter_child_nodes(node):
            self._read(child, inner, in_class=in_class)

    def _assign(
        self, target: ast.expr, value: ast.expr | None, scope: _Scope, *, in_class: bool
    ) -> None:
        match target, value:
            case ast.Tuple(elts=names), ast.Tuple(elts=values) if len(names) == len(values):
                for name, one in zip(names, values, strict=True):
                    self._assign(name, one, scope, in_class=in_class)
            case ((ast.Tuple(elts=names) | ast.List(elts=names)), _):
                for name in names:
                    self._assign(name, None, scope, in_class=in_class)
            case (ast.Attribute(attr=name), _):
                self._attributes.setdefault(name, []).append((value, scope))
            case (ast.Name(id=name), _) if in_class:
                self._attributes.setdefault(name, []).append((value, scope))
            case (ast.Name(id=name), _):
                self._bind(self._tree if (scope, name) in self._global else scope, name, value)

    def _bind(self, scope: _Scope, name: str, value: ast.expr | None) -> None:
        self._values.setdefault((scope, name), []).append((value, scope))

    def _bind_arguments(self) -> None:
        """Give the parameters of the file's own functions what their calls hand over."""
        for defined in self._functions.values():
            for function in defined:
                for position, argument in enumerate(function.args.args):
                    values = self._handed_over(function, position) if len(defined) == 1 else []
                    self._values.setdefault((function, argument.arg), []).extend(
                        values or [(None, function)]
                    )

    def _handed_over(self, function: ast.FunctionDef, position: int) -> list[_Value]:
        """What all calls give a parameter."""
        names = [argument.arg for argument in function.args.args]
        place = position - (names[0] == "self")
        values: list[_Value] = []
        for call, scope in self._calls:
            called = getattr(call.func, "id", None) or getattr(call.func, "attr", None)
            if called != function.name:
                continue
            named = [part.value for part in call.keywords if part.arg == names[position]]
            given = named or (call.args[place : place + 1] if place >= 0 else [])
            values.append((given[0] if given else None, scope))
        return values
