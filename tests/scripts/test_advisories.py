"""The audit of the locked packages: which advisories end it, and which are only reported."""

import advisories
import pytest
from advisories import Advisory, judged, pins, rounds

REPORT = {
    "dependencies": [
        {"name": "torch", "version": "2.13.0", "vulns": []},
        {"name": "ours", "skip_reason": "Dependency not found on PyPI"},
        {
            "name": "pillow",
            "version": "11.3.0",
            "vulns": [
                {"id": "PYSEC-1", "fix_versions": ["12.0.0", "12.1.0"], "aliases": ["CVE-1"]},
                {"id": "PYSEC-2", "fix_versions": [], "aliases": []},
            ],
        },
    ]
}


def test_advisories_are_read_with_the_age_of_their_first_fix():
    asked = []

    def days_since(package: str, version: str) -> float:
        asked.append((package, version))
        return 7.0

    found, skipped = advisories.advisories(REPORT, days_since)

    assert skipped == ["ours"]
    assert asked == [("pillow", "12.0.0")]
    assert [(a.id, a.fixed_days) for a in found] == [("PYSEC-1", 7.0), ("PYSEC-2", None)]


@pytest.mark.parametrize(
    ("fixed", "days", "strict", "passes"),
    [
        (("2",), 31.0, False, False),
        (("2",), 29.0, False, True),
        (("2",), None, False, True),
        ((), None, False, True),
        (("2",), 29.0, True, False),
    ],
    ids=["old fix", "new fix", "age unknown", "no fix", "strict"],
)
def test_an_advisory_fails_when_there_was_time_to_update(fixed, days, strict, passes):
    text, passed = judged([Advisory("a", "1", "ID-1", fixed, days)], {}, strict=strict)

    assert passed is passes
    assert "a 1: ID-1" in text
    assert ("UPDATE" in text) is not passes


def test_an_accepted_advisory_is_printed_with_its_reason():
    old = Advisory("a", "1", "ID-1", ("2",), 99.0)

    text, passed = judged([old], {"ID-1": "We never read such files."}, strict=True)

    assert passed
    assert "We never read such files." in text


def test_every_locked_version_is_asked_for_once():
    lists = rounds(pins())

    assert sorted(pair for each in lists for pair in each.items()) == sorted(pins())
    assert len(lists) == 2
