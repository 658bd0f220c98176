"""No duration is measured with the time of day, which somebody may set at any moment."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1] / "drcli"

AGES = {
    "checks/doctor/bucket_health.py": "the difference between the clocks of machine and server",
    "bucket/connect.py": "the age of a file, whose time is a time of day",
    "transfer/tidy.py": "the age of files and objects, whose times are times of day",
    "train/learner_metrics.py": "times of day of what happened before, counted back from now",
    "model/lease.py": "the age of a lease where the server tells no time",
    "store/s3_errors.py": "the difference between the clocks of this machine and the server",
}
"""Where nothing but the time of day is known."""

PACKAGES = ("base", "exchange", "learn", "runs", "store", "workers")


@pytest.mark.parametrize("package", PACKAGES)
def test_durations_come_from_clocks_that_nobody_sets(package):
    wrong = []
    for path in sorted((ROOT / package).rglob("*.py")):
        name = str(path.relative_to(ROOT))
        tree = ast.parse(path.read_text("utf-8"))
        begins = {
            target.id
            for node in ast.walk(tree)
            if isinstance(node, ast.Assign) and is_time_of_day(node.value)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub):
                sides = (node.left, node.right)
                named = any(isinstance(side, ast.Name) and side.id in begins for side in sides)
                if (named or any(map(is_time_of_day, sides))) and name not in AGES:
                    wrong.append(f"{name}:{node.lineno}")
            if isinstance(node, ast.Compare) and any(
                map(is_time_of_day, [node.left, *node.comparators])
            ):
                wrong.append(f"{name}:{node.lineno}")

    assert not wrong


def is_time_of_day(node: ast.expr) -> bool:
    """Whether this is a call of time.time()."""
    return (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in ("time", "time_ns")
        and isinstance(node.func.value, ast.Name)
        and node.func.value.id == "time"
    )
