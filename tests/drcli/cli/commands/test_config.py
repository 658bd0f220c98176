"""`dr config`, as people and scripts meet it."""

import json
import re

import pytest

from drcli.bucket.server import server


def test_values_are_lines_of_a_file_with_their_places(dr, working_folder, capsys):
    code = dr("config", "show")

    lines = capsys.readouterr().out.splitlines()
    assert code == 0
    assert any(re.fullmatch("DR_WORKERS=2 +# run.env line 3", line) for line in lines)
    assert any(re.fullmatch("DR_CAR_NAME=FastCar +# default", line) for line in lines)
    assert "# Training" in lines
    assert all(len(line) < 80 for line in lines if "http" not in line and "/" not in line)


def test_only_what_was_changed_is_shown_on_demand(dr, working_folder, capsys):
    dr("config", "show", "--changed")

    lines = [line for line in capsys.readouterr().out.splitlines() if line[:3] == "DR_"]
    assert [line.split()[0] for line in lines] == [
        "DR_WORKERS=2",
        "DR_LOCAL_S3_MODEL_PREFIX=model",
    ]


def test_nothing_changed_is_said(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("")

    dr("config", "show", "--changed")

    assert capsys.readouterr().out == "Every setting has its default.\n"


def test_a_named_value_is_explained(dr, working_folder, capsys):
    dr("config", "show", "workers", "DR_HOST_X")

    assert capsys.readouterr().out.splitlines() == [
        "DR_WORKERS=2  # run.env line 3",
        "  Number of simulation processes, here or with DR_LAUNCHER=ray in the cluster; "
        "deepracer-utils reads the first 10. With 0, all join from elsewhere (`dr-start-worker`).",
        "  Allowed: a whole number from 0 to 1000. Default: 1.",
        "DR_HOST_X=False  # default, no effect",
        "  Use the X server of the host.",
        "  Allowed: True or False. Default: False.",
        "  No effect here: drcli opens no window and needs no X server.",
    ]


def test_the_values_for_scripts_have_stable_keys(dr, working_folder, capsys):
    dr("config", "show", "DR_WORKERS", "--json")

    assert json.loads(capsys.readouterr().out) == {
        "directory": str(working_folder),
        "experiment": "",
        "settings": [
            {
                "name": "DR_WORKERS",
                "value": "2",
                "default": "1",
                "source": "run.env line 3",
                "file": "run.env",
                "line": 3,
                "changed": True,
                "effect": "used",
                "reason": "",
                "meaning": "Number of simulation processes, here or with DR_LAUNCHER=ray in the "
                "cluster; deepracer-utils reads the first 10. With 0, all join from elsewhere "
                "(`dr-start-worker`).",
                "expected": "a whole number from 0 to 1000",
                "group": "Training",
            }
        ],
        "workers": [],
    }


@pytest.mark.parametrize("arguments", [["show", "DR_WORKER"], ["set", "DR_WORKER=2"]])
def test_an_unknown_name_is_a_wrong_command_line_with_a_hint(dr, working_folder, capsys, arguments):
    code = dr("config", *arguments)

    assert code == 2
    assert "Did you mean DR_WORKERS?" in capsys.readouterr().err


def test_right_settings_pass_the_check(dr, working_folder, capsys):
    code = dr("config", "check", "--settings")

    printed = capsys.readouterr()
    assert (code, printed.out, printed.err) == (0, "Settings: 0 errors, 0 warnings.\n", "")


@pytest.fixture
def served(working_folder):
    """The working folder, whose S3 server ends with the test."""
    yield working_folder
    server.stop_default(working_folder)


def test_right_settings_are_followed_by_all_other_rules(dr, served, capsys):
    (served / "custom_files").mkdir(exist_ok=True)
    (served / "custom_files" / "hyperparameters.json").write_text('{"batch_size": "x"}')

    code = dr("config", "check", "--json")

    printed = json.loads(capsys.readouterr().out)
    assert code == 3
    assert (printed["valid"], printed["errors"]) == (False, [])
    assert any("batch_size" in error["message"] for error in printed["rules"]["errors"])


def test_no_rule_repeats_what_was_said_about_the_settings(dr, served, capsys):
    (served / "run.env").write_text("TEAM=blue\nDR_GUI_ENABLE=True\n")

    dr("config", "check")

    printed = capsys.readouterr().out
    assert printed.count("TEAM") == 1
    assert printed.count("DR_GUI_ENABLE") == 1
    assert "names them" not in printed


def test_everything_wrong_is_reported_at_once(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("DR_WORKERS=-1\nDR_WORLDNAME=x\nTEAM=blue\n")

    code = dr("config", "check")

    printed = capsys.readouterr()
    assert code == 3
    assert printed.out.splitlines() == [
        "Error: run.env line 1: DR_WORKERS=-1 is below 0.",
        "  Try: Set DR_WORKERS to a whole number from 0 to 1000, or leave it out for the default "
        "1.",
        "Error: run.env line 2: DR_WORLDNAME=x is not a setting.",
        "  Try: Did you mean DR_WORLD_NAME? Correct the name, or remove the line.",
        "Warning: run.env line 3: TEAM is not a setting and has no effect.",
        "Settings: 2 errors, 1 warning.",
    ]
    assert printed.err.splitlines()[0] == (
        "Error: run.env line 1: DR_WORKERS=-1 is below 0. And 1 more."
    )
    assert "Set DR_WORKERS to a whole number from 0 to 1000" in printed.err


def test_a_check_for_scripts_is_one_object_also_when_it_fails(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("DR_WORKERS=-1\n")

    code = dr("config", "check", "--json")

    assert code == 3
    assert json.loads(capsys.readouterr().out) == {
        "directory": str(working_folder),
        "valid": False,
        "errors": [
            {
                "where": "run.env line 1",
                "what": "DR_WORKERS=-1 is below 0",
                "remedy": "Set DR_WORKERS to a whole number from 0 to 1000, or leave it out for "
                "the default 1.",
            }
        ],
        "warnings": [],
        "without_effect": [],
        "rules": None,
    }


def test_what_has_no_effect_is_listed_by_reason(dr, working_folder, capsys):
    (working_folder / "system.env").write_text(
        "DR_SIMAPP_SOURCE=x/y\nDR_SIMAPP_VERSION=6.0.4-gpu\nDR_MINIO_IMAGE=latest\n"
        "DR_ANALYSIS_IMAGE=cpu\nDR_DOCKER_STYLE=swarm\nDR_HOST_X=False\n"
    )

    dr("config", "check", "--settings")

    assert capsys.readouterr().out.splitlines() == [
        "Accepted without effect:",
        "  no containers are used:",
        "    DR_SIMAPP_SOURCE, DR_SIMAPP_VERSION, DR_MINIO_IMAGE, DR_ANALYSIS_IMAGE, "
        "DR_DOCKER_STYLE",
        "  drcli opens no window and needs no X server:",
        "    DR_HOST_X",
        "Settings: 0 errors, 0 warnings.",
    ]


def test_a_value_is_changed_and_the_change_shown_with_its_folder(dr, working_folder, capsys):
    code = dr("config", "set", "workers=3", "DR_TRAIN_SEED=4")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out.splitlines() == [
        "run.env: DR_WORKERS=3  (was 2)",
        "run.env: DR_TRAIN_SEED=4",
    ]
    assert printed.err == f"Written in {working_folder}.\n"
    text = (working_folder / "run.env").read_text()
    assert text.endswith("DR_WORKERS=3\nDR_TRAIN_SEED=4\n")


def test_a_file_can_be_chosen(dr, working_folder, capsys):
    code = dr("config", "set", "DR_TRAIN_SEED=4", "--file", "system.env", "--json")

    assert code == 0
    assert json.loads(capsys.readouterr().out) == {
        "directory": str(working_folder),
        "changes": [{"name": "DR_TRAIN_SEED", "before": None, "after": "4", "file": "system.env"}],
        "warnings": [],
    }
    assert (working_folder / "system.env").read_text().endswith("DR_TRAIN_SEED=4\n")


def test_what_wins_over_a_change_is_said(dr, working_folder, capsys, monkeypatch):
    monkeypatch.setenv("DR_WORKERS", "5")

    dr("config", "set", "DR_WORKERS=3")

    printed = capsys.readouterr()
    assert printed.out == "run.env: DR_WORKERS=3  (was 2)\n"
    assert printed.err.startswith("Warning: environment: DR_WORKERS is set there and overrides")


def test_a_wrong_value_is_refused_and_nothing_written(dr, working_folder, capsys):
    before = (working_folder / "run.env").read_bytes()

    code = dr("config", "set", "DR_TRAIN_SEED=4", "DR_WORKERS=many")

    assert code == 3
    said = capsys.readouterr().err
    assert "run.env stays as it was: DR_WORKERS=many is not a whole number." in said
    assert (working_folder / "run.env").read_bytes() == before


def test_a_hyperparameter_is_told_where_it_belongs(dr, working_folder, capsys):
    code = dr("config", "set", "term_cond_max_episodes=30")

    said = capsys.readouterr().err
    assert code == 2
    assert "custom_files/hyperparameters.json" in said
    assert "Did you mean" not in said


@pytest.mark.parametrize(
    "arguments", [["DR_WORKERS"], ["DR_WORKERS=1", "--file", "worker-2.env"], []]
)
def test_a_wrong_command_line_is_one(dr, working_folder, arguments):
    assert dr("config", "set", *arguments) == 2


def test_a_name_of_the_racer_s_own_can_be_changed(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("TEAM=blue\nDR_LOCAL_S3_MODEL_PREFIX=$TEAM/m\n")

    dr("config", "set", "TEAM=red")

    assert (working_folder / "run.env").read_text().startswith("TEAM=red\n")


def test_no_secret_is_repeated(dr, working_folder, capsys):
    (working_folder / "system.env").write_text("AWS_SECRET_ACCESS_KEY=old-pst\n")

    dr("config", "set", "AWS_SECRET_ACCESS_KEY=new-pst")
    dr("config", "show", "AWS_SECRET_ACCESS_KEY")

    printed = capsys.readouterr()
    assert "pst" not in printed.out + printed.err
    assert (working_folder / "system.env").read_text() == "AWS_SECRET_ACCESS_KEY=new-pst\n"


def test_a_track_that_is_not_here_is_refused_with_the_likely_one(dr, working_folder, capsys):
    before = (working_folder / "run.env").read_bytes()

    code = dr("config", "set", "DR_WORLD_NAME=reinvent_bse")

    said = capsys.readouterr().err
    assert code == 3
    assert "run.env stays as it was: DR_WORLD_NAME=reinvent_bse is not a known track." in said
    assert "Did you mean reinvent_base?" in said
    assert (working_folder / "run.env").read_bytes() == before


def test_a_track_that_is_not_here_fails_the_check(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("DR_WORLD_NAME=Nope\n")

    code = dr("config", "check")

    assert code == 3
    assert "Error: run.env line 1: DR_WORLD_NAME=Nope" in capsys.readouterr().out


def test_a_track_that_was_missing_before_does_not_stop_other_changes(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("DR_WORLD_NAME=Nope\n")

    code = dr("config", "set", "DR_WORKERS=3")

    assert code == 0
    assert "DR_WORLD_NAME=Nope is not a known track. This was wrong before." in (
        capsys.readouterr().err
    )


def test_a_settings_file_that_is_a_folder_is_a_sentence(dr, working_folder, capsys):
    (working_folder / "run.env").unlink()
    (working_folder / "run.env").mkdir()

    code = dr("config", "set", "DR_WORKERS=3")

    assert code == 3
    assert "Error: run.env: cannot be read" in capsys.readouterr().err
