"""Looks up every locked package in PyPI's advisory data, and says which must be updated.

    scripts/audit.sh [--strict]

An advisory fails the check when a release with the fix has been out for 30 days. A younger one is
only reported: otherwise a change that has nothing to do with it could not be merged on the day on
which somebody publishes it. One without a fix is only reported too, as nobody could do anything. If
the advisory data cannot be reached, this is said, and the check passes; with `--strict` it fails,
and so does every advisory.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import requests
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
LOCKED = ROOT / "constraints"
ACCEPTED = LOCKED / "accepted-advisories.txt"

GRACE_DAYS = 30
TIMEOUT_S = 10.0
INDEX = "https://pypi.org"


@dataclass(frozen=True)
class Advisory:
    """One advisory about a version that is locked.

    Attributes:
        fixed: Versions with the fix, the oldest first.
        fixed_days: For how many days the first of them has been out; None without a fix.
    """

    package: str
    version: str
    id: str
    fixed: tuple[str, ...]
    fixed_days: float | None

    @property
    def due(self) -> bool:
        """Whether there was time enough to update."""
        return self.fixed_days is not None and self.fixed_days > GRACE_DAYS

    def __str__(self) -> str:
        where = f"{self.package} {self.version}: {self.id}"
        if not self.fixed:
            return f"{where}, no release with a fix yet"
        age = "" if self.fixed_days is None else f", released {self.fixed_days:.0f} days ago"
        return f"{where}, fixed in {self.fixed[0]}{age}"


def pins(folder: Path = LOCKED) -> set[tuple[str, str]]:
    """Name and version of every locked package, for all Pythons and processors."""
    found = set()
    for path in (folder / "default.txt", folder / "rendering.txt"):
        for line in path.read_text().splitlines():
            if line and not line.startswith("#"):
                pin = Requirement(line)
                found.add((canonicalize_name(pin.name), str(pin.specifier).removeprefix("==")))
    return found


def rounds(pinned: Iterable[tuple[str, str]]) -> list[dict[str, str]]:
    """The pins in as few lists as possible, each with one version of a package."""
    lists: list[dict[str, str]] = []
    for name, version in sorted(pinned):
        free = next((each for each in lists if name not in each), None)
        if free is None:
            lists.append(free := {})
        free[name] = version
    return lists


def accepted(path: Path = ACCEPTED) -> dict[str, str]:
    """Identifiers of advisories that do not matter here, and why."""
    lines = path.read_text().splitlines() if path.exists() else []
    pairs = (line.partition(" ") for line in lines if line and not line.startswith("#"))
    return {identifier: reason.strip() for identifier, _, reason in pairs}


def advisories(
    report: dict[str, Any], days_since: Callable[[str, str], float | None]
) -> tuple[list[Advisory], list[str]]:
    """The advisories in a report of pip-audit, and the packages that it could not look up.

    Args:
        report: Its JSON.
        days_since: How long a version of a package has been out.
    """
    found, skipped = [], []
    for package in report["dependencies"]:
        if "skip_reason" in package:
            skipped.append(package["name"])
            continue
        for entry in package["vulns"]:
            fixed = tuple(entry["fix_versions"])
            days = days_since(package["name"], fixed[0]) if fixed else None
            names = [entry["id"], *entry.get("aliases", [])]
            name = next((each for each in names if each in accepted()), entry["id"])
            found.append(Advisory(package["name"], package["version"], name, fixed, days))
    return found, skipped


def _reachable(pinned: set[tuple[str, str]]) -> bool:
    """Whether PyPI answers about a version; some mirrors only know the packages."""
    version = dict(pinned)["pip"]
    try:
        return requests.get(f"{INDEX}/pypi/pip/{version}/json", timeout=TIMEOUT_S).ok
    except requests.RequestException:
        return False


@cache
def _days_since(package: str, version: str) -> float | None:
    try:
        answer = requests.get(f"{INDEX}/pypi/{package}/{version}/json", timeout=TIMEOUT_S)
        files = answer.json()["urls"]
        released = min(datetime.fromisoformat(file["upload_time_iso_8601"]) for file in files)
    except (requests.RequestException, ValueError, KeyError):
        return None
    return (datetime.now(UTC) - released).total_seconds() / 86_400


def _asked(pinned: dict[str, str]) -> dict[str, Any]:
    """What pip-audit reports about these versions."""
    with tempfile.TemporaryDirectory() as folder:
        listed = Path(folder) / "requirements.txt"
        listed.write_text("".join(f"{name}=={version}\n" for name, version in pinned.items()))
        told = Path(folder) / "report.json"
        done = subprocess.run(
            [
                *(sys.executable, "-m", "pip_audit", "--requirement", listed, "--output", told),
                *("--no-deps", "--disable-pip", "--progress-spinner", "off", "--format", "json"),
            ],
            capture_output=True,
            text=True,
            check=False,
        )
        if not told.exists():
            raise SystemExit(f"pip-audit failed:\n{done.stderr}")
        report: dict[str, Any] = json.loads(told.read_text())
        return report


def judged(found: Iterable[Advisory], reasons: dict[str, str], *, strict: bool) -> tuple[str, bool]:
    """What to print about advisories, and whether the check passes."""
    lines, passes = [], True
    for advisory in found:
        if advisory.id in reasons:
            lines.append(f"accepted: {advisory} ({reasons[advisory.id]})")
        elif advisory.due or strict:
            lines.append(f"UPDATE:   {advisory}")
            passes = False
        else:
            lines.append(f"known:    {advisory}")
    return "\n".join(sorted(lines)), passes


def main() -> int:
    """Print the advisories; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--strict", action="store_true", help="fail for every advisory")
    strict = parser.parse_args().strict
    pinned = pins()
    if not _reachable(pinned):
        print(f"Audit: not done, because the advisory data of {INDEX} cannot be reached.")
        return int(strict)
    found, skipped = [], []
    for each in rounds(pinned):
        more, unknown = advisories(_asked(each), _days_since)
        found += more
        skipped += unknown
    text, passes = judged(found, accepted(), strict=strict)
    print(f"Audit: {len(pinned)} packages, {len(found)} advisories.")
    if text:
        print(text)
    if skipped:
        print(f"Not looked up: {', '.join(sorted(skipped))}.")
    if not passes:
        print("Write newer versions with `scripts/lock.sh -P PACKAGE`, and run the tests.")
        print(f"If an advisory does not matter here, say why in {ACCEPTED.relative_to(ROOT)}.")
    return int(not passes or (strict and bool(skipped)))


if __name__ == "__main__":
    raise SystemExit(main())
