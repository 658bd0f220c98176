"""The locked versions: what pyproject.toml asks for and all that this needs, and nobody else's."""

import importlib.metadata as metadata
import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
REMEDY = "Run scripts/lock.sh, and commit constraints/."


def locked(name: str) -> dict[str, list[Requirement]]:
    lines = (ROOT / "constraints" / f"{name}.txt").read_text().splitlines()
    found: dict[str, list[Requirement]] = {}
    for line in lines:
        if line and not line.startswith("#"):
            pin = Requirement(line)
            found.setdefault(canonicalize_name(pin.name), []).append(pin)
    return found


def asked_for(lock: str) -> list[Requirement]:
    extras = ["rendering"] if lock == "rendering" else EXTRAS.keys() - {"rendering"}
    lines = [*PROJECT["dependencies"], *(line for extra in extras for line in EXTRAS[extra])]
    return [Requirement(line) for line in lines]


def version_of(pin: Requirement) -> str:
    return re.fullmatch(r"==([^,*]+)", str(pin.specifier))[1]


@pytest.mark.parametrize("lock", ["default", "rendering"])
def test_every_dependency_is_locked_to_versions_that_it_allows(lock):
    pins = locked(lock)

    for wanted in [*asked_for(lock), Requirement("pip"), Requirement("hatchling")]:
        name = canonicalize_name(wanted.name)
        assert name in pins, f"{name} is not locked. {REMEDY}"
        for pin in pins[name]:
            assert wanted.specifier.contains(version_of(pin), prereleases=True), f"{pin}. {REMEDY}"


@pytest.mark.parametrize("lock", ["default", "rendering"])
def test_of_several_versions_one_fits_each_python_and_system(lock):
    systems = [
        {"python_version": python, "python_full_version": f"{python}.1"} | system
        for python in ("3.11", "3.12", "3.13")
        for system in (
            {"sys_platform": "linux", "platform_machine": "x86_64"},
            {"sys_platform": "linux", "platform_machine": "aarch64"},
            {"sys_platform": "darwin", "platform_machine": "arm64"},
        )
    ]

    for name, pins in locked(lock).items():
        for system in systems:
            fitting = [pin for pin in pins if pin.marker is None or pin.marker.evaluate(system)]
            assert len(fitting) <= 1, f"{name}: {fitting}. {REMEDY}"


def test_everything_that_an_installed_dependency_needs_is_locked():
    pins = locked("default")
    open_names = [(wanted.name, frozenset(wanted.extras)) for wanted in asked_for("default")]
    seen: set[tuple[str, frozenset[str]]] = set()

    while open_names:
        name, extras = open_names.pop()
        if (name, extras) in seen:
            continue
        seen.add((name, extras))
        assert canonicalize_name(name) in pins, f"{name} is not locked. {REMEDY}"
        try:
            needs = metadata.requires(name) or []
        except metadata.PackageNotFoundError:  # of an extra that the tests do without
            continue
        for line in needs:
            need = Requirement(line)
            if need.marker is None or any(
                need.marker.evaluate({"extra": extra}) for extra in ("", *extras)
            ):
                open_names.append((need.name, frozenset(need.extras)))

    assert len({name for name, _ in seen}) > len(asked_for("default"))
