"""Runs a benchmark and prints what it measured; each has --help.

python scripts/bench NAME [options]
"""

import ast
import runpy
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent

NAMES = (
    "analyze",
    "sim",
    "learn",
    "learners",
    "lap",
    "physics",
    "camera",
    "endurance",
    "fidelity",
    "gpu",
    "memory",
    "joined",
    "joined_faults",
    "joined_sums",
    "ray_nodes",
    "scale",
    "lag",
    "reference",
    "guide_values",
    "fast_lap",
    "goal",
    "teacher",
    "unseen",
    "flame",
    "flush",
    "rewards",
    "runtimes",
    "startup",
    "start",
    "live",
    "console_cost",
    "page_cost",
    "learn_lap_sb3",
    "fit_car",
    "reference_models",
    "robustness",
)


def run(name: str) -> None:
    """Run a benchmark with the options in sys.argv."""
    sys.path.insert(0, str(FOLDER))
    runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")


def overview() -> str:
    """All benchmarks, each with the first line of its docstring."""
    lines = [(__doc__ or "").strip(), ""]
    for name in NAMES:
        text = ast.get_docstring(ast.parse((FOLDER / f"{name}.py").read_text("utf-8"))) or ""
        lines.append(f"    {name:16} {text.splitlines()[0]}")
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark that the first argument names, or list all of them."""
    name, *options = [*sys.argv[1:], ""]
    if name in NAMES:
        sys.argv = [f"scripts/bench {name}", *options[:-1]]
        run(name)
    elif name in ("", "-h", "--help"):
        print(overview())
    else:
        sys.exit(f"'{name}' is not a benchmark. Names: {', '.join(NAMES)}.")


if __name__ == "__main__":
    main()
