"""What `dr config check` checks, and how often."""

from drcli.checks import settings_rules
from drcli.checks.config_check import check_alone, with_rules
from drcli.checks.doctor import diagnose
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


def test_a_track_that_is_not_installed_is_an_error_in_every_check(folder, dr, monkeypatch, capsys):
    folder.settings(DR_WORLD_NAME="LGSWide")
    told = "DR_WORLD_NAME=LGSWide is a community track that is not installed yet"
    monkeypatch.setattr(diagnose, "_on_this_machine", lambda *_: [])
    monkeypatch.setattr(diagnose, "_buckets", lambda *_: [])

    found = diagnose.diagnose(folder.path).findings

    assert [error.what for error in check_alone(folder.path).errors] == [told]
    assert [error.message for error in folder.report().errors] == [f"{told}."]
    assert [(each.state, told in each.text) for each in found] == [("problem", True)]
    capsys.readouterr()
    assert [dr("validate"), dr("config", "check")] == [3, 3]
    assert "would not start, except on a terminal, where it asks first." in capsys.readouterr().out


def test_a_track_that_a_start_never_fetches_starts_nowhere(folder, dr, capsys):
    folder.settings(DR_WORLD_NAME="LGSWide", DR_TRACKS_FETCH="never")

    assert dr("validate") == 3
    assert "A training would not start.\n" in capsys.readouterr().out


def test_an_update_warns_of_a_track_that_can_be_fetched_and_refuses_an_unknown_one(
    folder, dr, capsys
):
    folder.settings(DR_WORLD_NAME="LGSWide")
    assert dr("update") == 0
    printed = " ".join(capsys.readouterr().err.split())
    assert "Warning:" in printed
    assert "LGSWide is a community track that is not installed yet." in printed
    assert "`dr-tracks fetch LGSWide`, answer yes when a start asks on a terminal, or" in printed

    folder.settings(DR_WORLD_NAME="nowhere")
    assert dr("update") == 3
