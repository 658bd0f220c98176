"""Writes the pages of docs/ that are generated from the code; `--check` only says whether they are.

python scripts/write_docs.py            write them
python scripts/write_docs.py --check    exit 1 and name the pages that are stale
"""

import argparse
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import error_texts

from drcli.checks import rules
from drcli.cli.docs import manual
from drcli.config.document import settings_page

DOCS = Path(__file__).resolve().parents[1] / "docs"

PAGES: Mapping[str, Callable[[], str]] = {
    "commands.md": manual.document,
    "errors.md": error_texts.document,
    "settings.md": settings_page,
    "validation.md": rules.document,
}
"""Name of each page, and the function that returns its text."""


def stale(folder: Path) -> list[str]:
    """Names of the pages in a folder that do not say what the code says."""
    return [name for name, text in PAGES.items() if _content(folder / name) != text()]


def write(folder: Path) -> list[str]:
    """Write the stale pages of a folder.

    Returns:
        Their names.
    """
    names = stale(folder)
    for name in names:
        (folder / name).write_text(PAGES[name](), "utf-8")
    return names


def _content(path: Path) -> str | None:
    return path.read_text("utf-8") if path.exists() else None


def main() -> int:
    """Write or check, and say what was done."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing")
    checking = parser.parse_args().check
    names = stale(DOCS) if checking else write(DOCS)
    for name in names:
        print(f"docs/{name}: {'is stale' if checking else 'written'}")
    return int(checking and bool(names))


if __name__ == "__main__":
    sys.exit(main())
