"""Who may import whom: the table of docs/architecture.md, enforced."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

HEAVY = {"torch", "mujoco", "boto3", "botocore", "moto", "numba", "gymnasium"}
SCREEN = {"typer", "rich", "click"}
SETTINGS = {"pydantic", "dotenv"}

FORBIDDEN = {
    "drsim": {"drcli", "torch", "boto3", *SCREEN, *SETTINGS},
    "drcli.learn": {"drsim", "boto3", "mujoco", *SCREEN, *SETTINGS},
    "drcli.store": {"drsim", "torch", "mujoco", *SCREEN},
    "drcli.worker": {"boto3", *SCREEN},
    "drcli.runs": {"drsim", "numpy", *HEAVY, *SCREEN},
    "drcli.tracks": {"torch", "mujoco", "boto3", *SCREEN},
    "drcli.completing": {"drsim", "numpy", *HEAVY, *SCREEN},
    "drcli.setup": {"drsim", "numpy", *HEAVY, *SCREEN},
    "drcli.reward": {"torch", "mujoco", "boto3", *SCREEN},
    "drcli.transfer": {"drsim", "numpy", *HEAVY, *SCREEN},
    "drcli.commands": {"drsim", "numpy", *HEAVY},
    "drcli.settings": {"drsim", "numpy", *HEAVY, *SCREEN},
    "drcli.validate": {"drsim", "numpy", *HEAVY, *SCREEN},
}
"""Packages from outside that a package of ours must not import."""

OURS = {
    "drsim": {"drsim"},
    "drcli.learn": {"drcli.learn"},
    "drcli.store": {
        "drcli.store",
        "drcli.config.settings",
        "drcli.base.errors",
        "drcli.base.json_record",
        "drcli.base.notices",
        "drcli.config.secret_environment",
    },
    "drcli.worker": {
        "drcli.worker",
        "drcli.learn",
        "drcli.store",
        "drcli.config.settings",
        "drcli.base.errors",
        "drcli.exchange.job",
        "drcli.base.log_files",
        "drcli.modelfiles.hyperparameters",
        "drcli.modelfiles.model_metadata",
        "drcli.config.worlds",
        "drcli.checks.report",
        "drcli.base.signal_guard",
        "drsim",
    },
    "drcli.tracks": {
        "drcli.tracks",
        "drcli.config.settings",
        "drcli.base.errors",
        "drcli.__version__",
        "drsim",
    },
    "drcli.runs": {
        "drcli.runs",
        "drcli.store",
        "drcli.config.settings",
        "drcli.base.errors",
        "drcli.config.env_file",
        "drcli.base.problems",
        "drcli.exchange.job",
        "drcli.base.log_files",
        "drcli.base.json_record",
        "drcli.modelfiles.hyperparameters",
        "drcli.modelfiles.model_metadata",
        "drcli.base.atomic_file",
        "drcli.validate",
        "drcli.base.notices",
    },
    "drcli.reward": {
        "drcli.reward",
        "drcli.workers.build_race",
        "drcli.modelfiles.custom_files",
        "drcli.store.keys",
        "drcli.config.settings",
        "drcli.base.errors",
        "drcli.base.problems",
        "drcli.checks.first_step",
        "drcli.base.atomic_file",
        "drcli.base.signal_guard",
        "drcli.config.secret_environment",
        "drsim",
    },
    "drcli.validate": {
        "drcli.validate",
        "drcli.runs",
        "drcli.store",
        "drcli.config.settings",
        "drcli.base.errors",
        "drcli.base.problems",
        "drcli.checks.first_step",
        "drcli.exchange.job",
        "drcli.modelfiles.hyperparameters",
        "drcli.modelfiles.model_metadata",
        "drcli.base.text_file",
        "drcli.config.effects",
        "drcli.config.inspection",
        "drcli.config.worlds",
    },
}
"""Modules of ours that a package may import."""

LAZY = {"drcli.store": {"boto3", "botocore", "moto", "mypy_boto3_s3"}}
"""What a package may import inside functions only, because it takes long to load."""

PROGRAMS = {"moto_server.py"}
"""Modules that are only run, as processes of their own."""


def modules() -> list[Path]:
    return sorted([*(ROOT / "drcli").rglob("*.py"), *(ROOT / "env" / "drsim").rglob("*.py")])


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_a_module_imports_only_what_its_package_may(path):
    package = _package(path)
    outside = {name.split(".")[0] for name in _imports(path)} & FORBIDDEN.get(package, set())
    ours = {name for name in _imports(path) if name.split(".")[0] in ("drcli", "drsim")}
    allowed = OURS.get(package)

    wrong = outside | {
        name
        for name in ours
        if allowed is not None and not any(_within(name, permitted) for permitted in allowed)
    }

    assert not wrong, f"{package} must not import {sorted(wrong)}"


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_a_module_loads_slow_libraries_only_inside_functions(path):
    slow = set() if path.name in PROGRAMS else LAZY.get(_package(path), set())

    top = {name.split(".")[0] for name in _imports(path, top_level_only=True)}

    assert not top & slow


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_everything_public_says_what_it_is_for(path):
    tree = ast.parse(path.read_text("utf-8"))
    bare = [] if ast.get_docstring(tree) else [path.name]
    for node in tree.body:
        bare += _undocumented(node)

    assert not bare


def test_nothing_is_called_env_and_no_folder_of_ours_hides_it():
    assert not (ROOT / "env" / "__init__.py").exists()
    for path in modules():
        assert "env" not in {name.split(".")[0] for name in _imports(path)}, path


def _undocumented(node: ast.stmt) -> list[str]:
    if not isinstance(node, ast.FunctionDef | ast.ClassDef) or node.name.startswith("_"):
        return []
    bare = [] if ast.get_docstring(node) else [node.name]
    if isinstance(node, ast.ClassDef):
        methods = [item for item in node.body if isinstance(item, ast.FunctionDef)]
        bare += [f"{node.name}.{name}" for m in methods for name in _undocumented(m)]
    return bare


def _package(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    if parts[0] == "env":
        return "drsim"
    return ".".join(parts[:2])


def _within(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


def _imports(path: Path, *, top_level_only: bool = False) -> set[str]:
    """Names of modules that a file imports; `from a import b` may mean the module a.b."""
    tree = ast.parse(path.read_text("utf-8"))
    found: set[str] = set()
    for node in tree.body if top_level_only else ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            packages = ("drcli", "drcli.store", "drcli.learn", "drcli.worker", "drcli.runs")
            if node.module in packages:
                found |= {f"{node.module}.{alias.name}" for alias in node.names}
            else:
                found.add(node.module)
    return found
