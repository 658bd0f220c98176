"""Who may import whom: the floors of docs/architecture.md, enforced for every module."""

import ast
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec
from pathlib import Path

import pytest

from drcli.learn.algorithms import ALGORITHMS

ROOT = Path(__file__).resolve().parents[1]

FLOORS = {
    "drsim": (
        {"arrays", "errors", "jit"},
        {"track"},
        {"car"},
        {"race"},
        {"sensing"},
        {"episode"},
        {"viewing", "fidelity", "limit"},
        {"gym", "replay"},
        {"__init__"},
    ),
    "drcli": (
        {"__init__", "base", "learn"},
        {"clouds"},
        {"config"},
        {"records"},
        {"tracks", "bucket"},
        {"model"},
        {"metrics", "workers", "convert"},
        {"live"},
        {"drive"},
        {"train", "transfer"},
        {"rewards"},
        {"checks", "outside", "view"},
        {"analysis"},
        {"run"},
        {"races", "sweeps"},
        {"web"},
        {"cli"},
    ),
}
"""Packages and root modules of each tree, the lowest first.

A module imports from its own package and from lower floors only.
"""

SIMULATION = {"drsim", "mujoco", "numba", "gymnasium"}
LEARNING = {"torch"}
STORAGE = {"boto3", "botocore", "moto"}
SCREEN = {"typer", "rich", "click"}

FORBIDDEN = {
    "drsim": {"drcli", *LEARNING, *STORAGE, *SCREEN, "pydantic", "dotenv"},
    "drcli.base": {*SIMULATION, *LEARNING, *STORAGE, *SCREEN},
    "drcli.learn": {*SIMULATION, *STORAGE, *SCREEN, "pydantic", "dotenv"},
    "drcli.clouds": {*SIMULATION, *LEARNING, *STORAGE, *SCREEN, "numpy"},
    "drcli.config": {*SIMULATION, *LEARNING, *STORAGE, *SCREEN, "numpy"},
    "drcli.records": {*SIMULATION, *LEARNING, *STORAGE, *SCREEN},
    "drcli.tracks": {*LEARNING, *STORAGE, *SCREEN, "mujoco"},
    "drcli.bucket": {*SIMULATION, *LEARNING, *SCREEN},
    "drcli.model": {*SIMULATION, *LEARNING, *STORAGE, *SCREEN, "numpy"},
    "drcli.metrics": {*SIMULATION, *LEARNING, *STORAGE, *SCREEN, "numpy"},
    "drcli.workers": {*STORAGE, *SCREEN, *LEARNING, "mujoco"},
    "drcli.convert": {*SIMULATION, *STORAGE, *SCREEN},
    "drcli.live": {*STORAGE, *SCREEN},
    "drcli.drive": {*STORAGE, *SCREEN},
    "drcli.train": {*STORAGE, *SCREEN},
    "drcli.transfer": {*SIMULATION, *STORAGE, *SCREEN},
    "drcli.rewards": {*LEARNING, *STORAGE, *SCREEN, "mujoco"},
    "drcli.checks": {"boto3", "moto", *SCREEN},
    "drcli.outside": {*SIMULATION, *LEARNING, *SCREEN, "numpy"},
    "drcli.view": {*STORAGE, *SCREEN, "mujoco"},
    "drcli.analysis": {*LEARNING, *STORAGE, *SCREEN, "mujoco"},
    "drcli.run": {*SIMULATION, *LEARNING, *STORAGE, *SCREEN, "numpy"},
    "drcli.races": {*SIMULATION, *LEARNING, *STORAGE, *SCREEN, "numpy"},
    "drcli.web": {*LEARNING, *STORAGE, *SCREEN, "mujoco"},
    "drcli.cli": {*SIMULATION, *LEARNING, *STORAGE, "numpy"},
}
"""Packages from outside, and drsim, that a package must not import."""

LAZY = {
    "drcli.bucket": STORAGE | {"mypy_boto3_s3"},
    "drcli.outside": STORAGE | {"requests", "urllib3", "ssl", "s3transfer"},
    "drcli.analysis": {"pandas", "deepracer", "matplotlib"},
}
"""What a package may import in `lazy_imports()` only, because it takes long to load."""

PROGRAMS = {"drcli.bucket.server.moto_server"}
"""Modules that are only run, as processes of their own."""


UNIMPORTED = {
    "drcli.base.start_module",
    "drcli.cli.program",
    "drcli.cli.called_command",
    "drcli.rewards.sandbox.sandbox_process",
    "drcli.outside.aws.boot",
    "drcli.bucket.server.moto_server",
    "drcli.web.reward_process",
    "drcli.view.playback.player_process",
    "drcli.web.serve",
    "drcli.run.launchers.placed_trainer",
    "drcli.train.joined_sim",
    "drcli.train.learner_process",
    "drcli.run.launchers.ray_workers",
    "drcli.drive.reward_server",
    "drcli.drive.evaluate_many",
    "drcli.drive.try_cars",
    "drcli.checks.doctor.library_facts",
    "drcli.checks.bench.measure_process",
    "drsim.replay",
}
"""Modules that are started by name, as programs or processes."""


@cache
def modules() -> dict[str, Path]:
    """Every module of ours by its dotted name; a package by its own."""
    found = {}
    for top in (ROOT / "drcli", ROOT / "env" / "drsim"):
        for path in sorted(top.rglob("*.py")):
            parts = path.relative_to(top.parent).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            found[name] = path
    return found


def test_modules_import_from_lower_floors_only():
    wrong = {
        (name, other)
        for name in modules()
        for other in ours(name)
        if other.split(".")[0] == name.split(".")[0]
        and room(other) != room(name)
        and floor(other) >= floor(name)
    }

    assert not wrong


def test_modules_import_only_the_libraries_that_their_package_may():
    wrong = {
        (name, library)
        for name in modules()
        for library in libraries(name) & FORBIDDEN.get(package(name), set())
    }

    assert not wrong


def test_modules_load_slow_libraries_only_when_they_use_them():
    wrong = {
        (name, library)
        for name in modules().keys() - PROGRAMS
        for library in libraries(name, top_level_only=True) & LAZY.get(package(name), set())
    }

    assert not wrong


@pytest.mark.parametrize("program", ["drcli.run.training", "drcli.web.serve"])
def test_what_runs_for_hours_does_not_load_what_workers_compute_with(program):
    """It runs beside them: torch alone would take 160 MB and seconds to start."""
    loaded, waiting = set(), [program]
    while waiting:
        name = waiting.pop()
        if name not in loaded:
            loaded.add(name)
            waiting += with_packages(imports(name, top_level_only=True)) & modules().keys()
    heavy = {"torch", "mujoco", "numba", "scipy"}

    assert len(loaded) > 50
    assert not {name for name in loaded if libraries(name, top_level_only=True) & heavy}


def test_only_modules_are_imported_lazily():
    """Any other name would be taken for a module, and fail at its first use."""
    blocks = [
        (name, node)
        for name, path in modules().items()
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.With)
        and any(ast.unparse(item.context_expr) == "lazy_imports()" for item in node.items)
    ]
    wrong = {
        (name, f"{line.module}.{alias.name}")
        for name, block in blocks
        for line in block.body
        if isinstance(line, ast.ImportFrom)
        for alias in line.names
        if not is_module(str(line.module), alias.name)
    }

    assert len(blocks) > 50
    assert not wrong


def is_module(parent: str, name: str) -> bool:
    """Whether a package has it, without loading the package; true where it is not installed."""
    top, *between = parent.split(".")
    found = find_spec(top)
    if found is None:
        return True
    places = [Path(place, *between) for place in found.submodule_search_locations or ()]
    kinds = ("", ".py", *EXTENSION_SUFFIXES)
    return any((place / f"{name}{kind}").exists() for place in places for kind in kinds)


def test_few_imports_stand_inside_functions():
    inside = Counter(name for name in modules() for _ in range(facts(name).inside))

    assert inside.total() <= 20, inside


def test_no_modules_import_each_other_in_a_circle():
    waiting = {name: set(ours(name)) - {name} for name in modules()}
    while free := {name for name, needs in waiting.items() if not needs}:
        waiting = {name: needs - free for name, needs in waiting.items() if name not in free}

    assert not waiting, f"In or above circles: {sorted(waiting)}"


def test_every_module_is_imported_or_started_by_name():
    """But for commands, learners and clouds, which tables name."""
    imported = set().union(*(ours(name) - {name} for name in modules()))
    imported |= {each.learner.partition(":")[0] for each in ALGORITHMS.values()}

    unused = {
        name
        for name, path in modules().items()
        if name not in imported
        and path.name != "__init__.py"
        and not name.startswith(("drcli.cli.commands.", "drcli.clouds.providers."))
    }

    assert unused == UNIMPORTED


def test_scripts_import_what_is_there():
    """Nothing else runs them between two releases."""
    missing = {
        (path.name, f"{node.module}.{alias.name}")
        for path in sorted((ROOT / "scripts").rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").split(".")[0] in ("drcli", "drsim")
        for alias in node.names
        if f"{node.module}.{alias.name}" not in modules()
        and alias.name not in bound_names(str(node.module))
    }

    assert not missing


def test_every_package_stands_on_a_floor():
    for name in modules():
        assert floor(name) >= 0, f"{name}: add its package to FLOORS"


def test_few_modules_stand_in_the_root_of_a_tree():
    assert len(list((ROOT / "drcli").glob("*.py"))) <= 3
    assert {path.stem for path in (ROOT / "env" / "drsim").glob("*.py")} == {
        "arrays",
        "__init__",
        "errors",
        "jit",
        "replay",
    }


@pytest.mark.parametrize("tree", ["drcli", "drsim"])
def test_a_module_name_occurs_once(tree):
    """But for the files in cli/commands, each of which is named after its command."""
    names = Counter(
        name.rpartition(".")[2]
        for name, path in modules().items()
        if name.split(".")[0] == tree
        and not name.startswith(("drcli.cli.commands.", "drcli.clouds.providers."))
        and path.name != "__init__.py"
    )

    assert not {name for name, times in names.items() if times > 1}


def test_only_the_command_line_prints():
    elsewhere = (name for name in modules() if package(name) != "drcli.cli")

    assert not {(name, line) for name in elsewhere for line in facts(name).prints}


def test_every_module_says_what_it_holds():
    assert not {name for name in modules() if not facts(name).documented}


def test_nothing_is_called_env_and_no_folder_of_ours_hides_it():
    assert not (ROOT / "env" / "__init__.py").exists()
    for name in modules():
        assert "env" not in libraries(name), name


@cache
def bound_names(name: str) -> frozenset[str]:
    """Names that a module of ours binds anywhere; none where there is no such module."""
    path = modules().get(name)
    nodes = [] if path is None else list(ast.walk(ast.parse(path.read_text("utf-8"))))
    bound = {node.id for node in nodes if isinstance(node, ast.Name)}
    bound |= {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    bound |= {node.asname or node.name for node in nodes if isinstance(node, ast.alias)}
    return frozenset(bound)


def package(name: str) -> str:
    """The package that a module belongs to, as in FORBIDDEN."""
    return "drsim" if name.split(".")[0] == "drsim" else ".".join(name.split(".")[:2])


def room(name: str) -> str:
    """The package or root module of a tree that a module belongs to, as in FLOORS."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def floor(name: str) -> int:
    """The floor of a module; -1 where FLOORS does not name it."""
    floors = FLOORS[name.split(".")[0]]
    return next((i for i, rooms in enumerate(floors) if room(name) in rooms), -1)


def ours(name: str) -> set[str]:
    """The modules of ours that a module imports."""
    return set(imports(name) & modules().keys())


def imports(name: str, *, top_level_only: bool = False) -> frozenset[str]:
    """Names of modules that a module imports; `from a import b` may mean the module a.b."""
    return facts(name).top_level if top_level_only else facts(name).imports


def with_packages(names: Iterable[str]) -> set[str]:
    """Python loads the packages of a module before it."""
    return {".".join(name.split(".")[:end]) for name in names for end in range(1, 9)}


def libraries(name: str, *, top_level_only: bool = False) -> set[str]:
    """The top names of what a module imports, `torch` of `torch.nn`; ours too."""
    found = imports(name, top_level_only=top_level_only)
    return {imported.split(".")[0] for imported in found}


@dataclass(frozen=True)
class Facts:
    """What the source of a module says.

    Attributes:
        imports: Names of modules that it imports anywhere.
        top_level: Those that are loaded with it.
        inside: How many imports stand inside functions.
        prints: Lines of calls of `print`.
        documented: Whether it says what it holds.
    """

    imports: frozenset[str]
    top_level: frozenset[str]
    inside: int
    prints: tuple[int, ...]
    documented: bool


@cache
def facts(name: str) -> Facts:
    """Of a module, read once for all tests."""
    tree = ast.parse(modules()[name].read_text("utf-8"))
    nodes = list(ast.walk(tree))
    calls = (node for node in nodes if isinstance(node, ast.Call))
    prints = [c.lineno for c in calls if isinstance(c.func, ast.Name) and c.func.id == "print"]
    return Facts(
        frozenset(_imports(nodes)),
        frozenset(_imports(tree.body)),
        sum(isinstance(inner, ast.Import | ast.ImportFrom) for inner in _in_functions(nodes)),
        tuple(prints),
        ast.get_docstring(tree) is not None,
    )


def _in_functions(nodes: Iterable[ast.AST]) -> set[ast.AST]:
    functions = (node for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    return {inner for function in functions for inner in ast.walk(function)}


def _imports(nodes: Iterable[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield whole if whole in modules() else node.module
