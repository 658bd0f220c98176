"""What `dr config check` checks, and how often."""

from drcli.checks import settings_rules
from drcli.checks.config_check import check_alone, with_rules
from drcli.config import settings_report
from drcli.config.loading import load_settings


def test_the_settings_are_loaded_twice_at_most(folder, monkeypatch):
    loads = []

    def load(*arguments, **options):
        loads.append(arguments)
        return load_settings(*arguments, **options)

    monkeypatch.setattr(settings_report, "load_settings", load)
    monkeypatch.setattr(settings_rules, "load_settings", load)

    report = with_rules(check_alone(folder.path))

    assert report.valid
    assert len(loads) == 2


def test_an_unknown_track_is_told_beside_other_wrong_settings(folder):
    folder.settings(DR_WORKERS=-1, DR_WORLD_NAME="nowhere")

    errors = check_alone(folder.path).errors

    told = {error.message for error in folder.report().errors}
    assert [error.what for error in errors] == [
        "DR_WORLD_NAME=nowhere is not a known track",
        "DR_WORKERS=-1 is below 0",
    ]
    assert told == {f"{error.what}." for error in errors}
