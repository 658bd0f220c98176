"""Looks at a stranger's reward function without running it."""

import ast

from drcli.store.keys import REWARD_FUNCTION_FILE

_NAME = "reward_function"


def reward_fault(data: bytes) -> str | None:
    """Why not, or None."""
    try:
        tree = ast.parse(data.decode("utf-8-sig"), REWARD_FUNCTION_FILE)
    except SyntaxError as error:
        return f"line {error.lineno} is not Python ({error.msg})"
    except (ValueError, RecursionError, MemoryError):
        return "it is not Python in UTF-8"
    names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    for node in tree.body:
        if isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.ImportFrom | ast.Import):
            names |= {alias.asname or alias.name for alias in node.names}
    return None if _NAME in names else f"it does not define {_NAME}"
