"""Writes the pages of docs/ that are generated from the code, or draws pictures for them.

python scripts/docs               write the pages
python scripts/docs --check       exit 1 and name the pages that are out of date
python scripts/docs pictures ...  draw what the cameras see; see its --help
python scripts/docs knobs ...     draw what hyperparameters change; see its --help
python scripts/docs terminal ...  record the live display of a training; see its --help
python scripts/docs lap ...       record a lap of a trained model; see its --help
python scripts/docs console ...   draw the pages of the console; see its --help
"""

import argparse
import runpy
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import commands_page
import errors_page
import explained_pages
import settings_page

FOLDER = Path(__file__).resolve().parent
DOCS = FOLDER.parents[1] / "docs"

PAGES: Mapping[str, Callable[[], str]] = {
    "commands.md": commands_page.document,
    "errors.md": errors_page.document,
    "glossary.md": explained_pages.glossary,
    "hyperparameters.md": explained_pages.hyperparameters,
    "settings.md": settings_page.document,
    "troubleshooting.md": explained_pages.troubleshooting,
}
"""Name of each page, and the function that returns its text."""

DRAWINGS: Mapping[str, str] = {
    "pictures": "pictures",
    "knobs": "knobs",
    "terminal": "terminal",
    "lap": "lap_picture",
    "console": "console_pictures",
}
"""Name of each drawing, and its module; scripts/bench has a module `lap` on the same path."""


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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="write nothing")
    checking = parser.parse_args().check
    names = stale(DOCS) if checking else write(DOCS)
    for name in names:
        print(f"docs/{name}: {'is out of date' if checking else 'written'}")
    return int(checking and bool(names))


if __name__ == "__main__":
    if sys.argv[1:2] and sys.argv[1] in DRAWINGS:
        module = DRAWINGS[sys.argv.pop(1)]
        sys.path.append(str(FOLDER.parent / "bench"))  # some draw what a benchmark measures
        runpy.run_path(str(FOLDER / f"{module}.py"), run_name="__main__")
    else:
        sys.exit(main())
