"""`python scripts/docs` writes the generated pages, and --check only names them."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ENTRY = Path(__file__).resolve().parents[2] / "scripts" / "docs" / "__main__.py"


@pytest.fixture
def docs(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, with one page that is quickly written."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    spec = importlib.util.spec_from_file_location("docs_entry", ENTRY)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "PAGES", {"page.md": lambda: "new"})
    return module


def test_the_script_writes_what_is_stale_and_nothing_else(docs, tmp_path):
    (tmp_path / "page.md").write_text("old")
    before = docs.stale(tmp_path)

    written = docs.write(tmp_path)

    assert before == written == ["page.md"]
    assert docs.stale(tmp_path) == []
    assert docs.write(tmp_path) == []


@pytest.mark.parametrize(("page", "code"), [("old", 1), ("new", 0)])
def test_checking_only_names_the_stale_pages(docs, tmp_path, monkeypatch, capsys, page, code):
    (tmp_path / "page.md").write_text(page)
    monkeypatch.setattr(docs, "DOCS", tmp_path)
    monkeypatch.setattr(sys, "argv", ["docs", "--check"])

    assert docs.main() == code
    assert ("page.md: is out of date" in capsys.readouterr().out) == bool(code)
    assert (tmp_path / "page.md").read_text() == page
