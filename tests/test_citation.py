"""CITATION.cff names the version, authors and licence that the package has."""

import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]


def test_the_citation_is_of_this_version_and_of_its_authors():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    [author] = citation["authors"]

    assert citation["cff-version"] == "1.2.0"
    assert citation["message"]
    assert citation["title"].startswith(project["name"])
    assert str(citation["version"]) == project["version"]
    assert citation["license"] == project["license"]
    assert f"{author['name']}\n" in (ROOT / "LICENSE").read_text()
