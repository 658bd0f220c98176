"""`dr update`, `dr update-env` and `dr reload` as their caller meets them."""

import json

import pytest


@pytest.mark.parametrize("name", ["update", "update-env", "reload"])
def test_right_settings_are_said_to_be_right_in_one_line(dr, working_folder, capsys, name):
    code = dr(name)

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out == ""
    assert (
        printed.err
        == "5 settings of run.env and system.env are right; there is nothing to reload.\n"
    )


def test_what_is_odd_is_shown_and_no_failure(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("DR_WORKERS=1\nDR_WORKERS=2\n")

    code = dr("update")

    assert code == 0
    assert "Warning: run.env line 2: DR_WORKERS is also set at" in capsys.readouterr().err


def test_quiet_is_silent(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("DR_WORKERS=1\nDR_WORKERS=2\n")

    code = dr("reload", "-q")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out + printed.err == ""


def test_wrong_settings_exit_3_with_file_and_line(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("DR_WORKERS=many\n")

    code = dr("update", "-q")

    assert code == 3
    assert "run.env line 1: DR_WORKERS=many" in capsys.readouterr().err


def test_programs_get_files_and_warnings(dr, working_folder, capsys):
    dr("update", "-q", "--json")

    report = json.loads(capsys.readouterr().out)
    assert report == {"files": ["run.env", "system.env"], "settings": 5, "warnings": []}
