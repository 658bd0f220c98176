"""Probes that fail, hang, or find something."""

import threading
import time

from drcli.base.errors import StorageError
from drcli.checks.doctor.findings import DoctorReport, Examination, Finding, Probe, shown_bytes

GOOD = Finding("disk", "ok", "61 GB free")


def test_a_probe_that_hangs_does_not_keep_the_others_from_reporting():
    over = threading.Event()

    def hang():
        yield GOOD
        over.wait(60)

    began_s = time.monotonic()
    examination = Examination([Probe("disk", hang), Probe("locale", lambda: [GOOD])])
    examination.wait(0.2)
    first, late, last = examination.findings()
    over.set()

    assert time.monotonic() - began_s < 5
    assert first == last == GOOD
    assert (late.subject, late.state) == ("disk", "warning")
    assert "not finished" in late.text


def test_a_failure_is_a_finding_with_what_came_before():
    def fail():
        yield GOOD
        raise StorageError("The bucket is gone.", remedy="Create it.")

    def crash():
        yield from ()
        raise ZeroDivisionError("1 / 0")

    examination = Examination([Probe("bucket", fail), Probe("limits", crash)])
    examination.wait(5)
    kept, failed, crashed = examination.findings()

    assert kept == GOOD
    assert (failed.state, failed.text, failed.remedy) == (
        "problem",
        "The bucket is gone.",
        "Create it.",
    )
    assert crashed.state == "warning"
    assert "ZeroDivisionError: 1 / 0" in crashed.text


def report(*subjects_and_states):
    return DoctorReport("/x", 1.0, tuple(Finding(*each, "text") for each in subjects_and_states))


def test_the_exit_code_says_whether_the_machine_or_only_the_bucket_has_a_problem():
    assert report(("disk", "ok"), ("GPU", "warning")).exit_code == 0
    assert report(("bucket", "problem"), ("upload bucket", "problem")).exit_code == 4
    assert report(("bucket", "problem"), ("disk", "problem")).exit_code == 3


def test_sizes_are_short():
    sizes = (63.4e9, 2.1e6, 500, 3e12)
    assert [shown_bytes(size) for size in sizes] == ["63.4 GB", "2.1 MB", "0.5 kB", "3 TB"]
