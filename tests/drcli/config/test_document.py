"""docs/settings.md says what the code says."""

import importlib.util
import sys
from pathlib import Path

import pytest

from drcli.config.document import settings_page
from drcli.config.former_names import FORMER
from drcli.config.settings import catalogue

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def write_docs(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    spec = importlib.util.spec_from_file_location("write_docs", ROOT / "scripts" / "write_docs.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "PAGES", {"settings.md": settings_page})
    return module


def test_the_page_is_current_or_else_run_the_script():
    assert (ROOT / "docs" / "settings.md").read_text("utf-8") == settings_page()


def test_every_setting_has_one_row():
    rows = [line for line in settings_page().splitlines() if line.startswith("| `DR_")]

    assert sorted(row.split("`")[1] for row in rows) == sorted([*catalogue(), *FORMER])


def test_a_row_holds_default_meaning_range_and_file():
    assert (
        "| `DR_WORKERS` | `1` | Number of simulation processes; analysis tools read at most 10. "
        "| a whole number from 1 to 10 | system.env |" in settings_page().splitlines()
    )


def test_a_setting_without_effect_says_why():
    rows = [line for line in settings_page().splitlines() if line.startswith("| `DR_DOCKER_STYLE`")]

    assert rows == ["| `DR_DOCKER_STYLE` | How containers are started. | no containers are used |"]


def test_the_script_writes_what_is_stale_and_nothing_else(write_docs, tmp_path):
    (tmp_path / "settings.md").write_text("old")
    before = write_docs.stale(tmp_path)

    written = write_docs.write(tmp_path)

    assert before == written
    assert "settings.md" in written
    assert write_docs.stale(tmp_path) == []
    assert write_docs.write(tmp_path) == []


@pytest.mark.parametrize(("page", "code"), [("old", 1), (settings_page(), 0)])
def test_checking_only_names_the_stale_pages(write_docs, tmp_path, monkeypatch, capsys, page, code):
    (tmp_path / "settings.md").write_text(page)
    monkeypatch.setattr(write_docs, "DOCS", tmp_path)
    monkeypatch.setattr(sys, "argv", ["write_docs.py", "--check"])

    assert write_docs.main() == code
    assert ("settings.md: is stale" in capsys.readouterr().out) == bool(code)
    assert (tmp_path / "settings.md").read_text() == page
