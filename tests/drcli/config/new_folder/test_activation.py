"""What activation leaves in a shell: every setting, and nothing that hides a later edit."""

import shlex
from pathlib import Path

import pytest

from drcli.base.errors import SettingsError
from drcli.config import activation
from drcli.config.loading import active_run_file, load_settings
from drcli.config.shell_variables import shell_change


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "system.env").write_text("DR_LOCAL_S3_BUCKET=racers\nDR_AWS_APP_REGION=eu-west-1\n")
    (tmp_path / "run.env").write_text(
        "DR_WORLD_NAME=reinvent_base\nDR_LOCAL_S3_MODEL_PREFIX=first\n"
        "DR_LOCAL_S3_METRICS_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX/numbers\n"
        "DR_REGULAR_UPLOAD=60\nMY_OWN='two words; $HOME'\n"
    )
    return tmp_path


@pytest.fixture
def experiment(folder: Path) -> str:
    (folder / "experiments" / "fast").mkdir(parents=True)
    (folder / "experiments" / "fast" / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=quick\n")
    return "fast"


def activated(folder: Path, **more: str) -> dict[str, str]:
    """The environment of a shell after activation."""
    return {**more, **shell_change(folder, more).export}


def test_every_name_of_both_files_is_exported_with_its_references_filled_in(folder):
    shell = activated(folder)

    assert shell["DR_LOCAL_S3_BUCKET"] == "racers"
    assert shell["DR_LOCAL_S3_METRICS_PREFIX"] == "first/numbers"
    assert shell["DR_REGULAR_UPLOAD"] == "60"
    assert shell["MY_OWN"] == "two words; $HOME"
    assert shell["DR_DIR"] == str(folder)
    assert shell["DR_CONFIG"] == str(folder / "run.env")


@pytest.mark.parametrize(
    ("line", "name", "used"),
    [
        ("DR_LOCAL_S3_MODEL_PREFIX=/team//model-1/", "DR_LOCAL_S3_MODEL_PREFIX", "team/model-1"),
        ("DR_UPLOAD_S3_PREFIX=$DR_WORLD_NAME/", "DR_UPLOAD_S3_PREFIX", "bean"),
        ("DR_RACE_TYPE=time_trial", "DR_RACE_TYPE", "TIME_TRIAL"),
        ("DR_CLOUD=azure", "DR_CLOUD", "local"),
        ("DR_WORKERS=many", "DR_WORKERS", "many"),
        ("DR_RACE_TYPE=rally", "DR_RACE_TYPE", "rally"),
        ("DR_UPLOAD_S3_PREFIX=", "DR_UPLOAD_S3_PREFIX", ""),
    ],
)
def test_a_value_is_exported_as_the_commands_read_it(folder, line, name, used):
    (folder / "run.env").write_text(f"DR_WORLD_NAME=bean\n{line}\n")

    assert activated(folder)[name] == used


def test_what_is_made_of_a_prefix_has_no_double_slash(folder):
    (folder / "run.env").write_text(
        "DR_LOCAL_S3_MODEL_PREFIX=model-1/\n"
        "DR_LOCAL_S3_METRICS_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX/metrics\n"
        "MY_LOGS=logs/$DR_LOCAL_S3_MODEL_PREFIX/today\n"
    )

    shell = activated(folder)

    assert shell["DR_LOCAL_S3_METRICS_PREFIX"] == "model-1/metrics"
    assert shell["MY_LOGS"] == "logs/model-1/today"


def test_what_scripts_of_the_reference_expect_besides_is_exported_too(folder):
    (folder / "system.env").write_text(
        "DR_CLOUD=remote\nDR_REMOTE_MINIO_URL=http://nas:9000\nDR_LOCAL_S3_PROFILE=minio\n"
        "DR_AWS_APP_REGION=eu-west-1\n"
    )

    shell = activated(folder)

    assert shell["DR_RUN_ID"] == "0"
    assert shell["AWS_DEFAULT_REGION"] == "eu-west-1"
    assert shell["DR_LOCAL_S3_ENDPOINT_URL"] == "http://nas:9000"
    assert (
        shell["DR_LOCAL_PROFILE_ENDPOINT_URL"] == "--profile minio --endpoint-url http://nas:9000"
    )


def test_the_address_of_the_embedded_server_is_known_once_it_was_started(folder):
    before = activated(folder)
    (folder / "data" / "s3").mkdir(parents=True)
    (folder / "data" / "s3" / ".server.json").write_text('{"port": 20123}')

    after = activated(folder)

    assert "DR_LOCAL_S3_ENDPOINT_URL" not in before
    assert after["DR_LOCAL_S3_ENDPOINT_URL"] == "http://127.0.0.1:20123"


def test_nothing_that_activation_exported_is_an_override(folder, experiment):
    plain = activated(folder)
    chosen = {**plain, **shell_change(folder, plain, experiment=experiment).export}

    assert activation.places(plain) == {}
    assert activation.places(chosen) == {}


def test_what_is_set_for_one_command_is_an_override_in_an_activated_shell_too(folder, tmp_path):
    other = str(tmp_path / "other")
    once = {"DR_RUN_ID": "3", "DR_LOCAL_S3_MODEL_PREFIX": "my model", "DR_DIR": other}

    assert activation.places({**activated(folder), **once, "DR_WORKERS": "2"}) == once
    assert activation.places(once) == once


def test_a_bucket_for_one_command_is_an_override_but_for_a_password(folder):
    once = {"DR_CLOUD": "remote", "DR_LOCAL_S3_PROFILE": "nas", "DR_LOCAL_S3_BUCKET": "other"}
    address = {"DR_REMOTE_MINIO_URL": "http://nas:9000"}
    secret = {"DR_REMOTE_MINIO_URL": "http://me:word@nas:9000"}

    assert activation.places({**activated(folder), **once, **address}) == {**once, **address}
    assert activation.places({**once, **secret}) == once


def test_another_experiment_than_the_activated_one_is_an_override(folder, experiment):
    shell = {**shell_change(folder, {}, experiment=experiment).export, "DR_EXPERIMENT_NAME": "slow"}

    assert activation.places(shell) == {"DR_EXPERIMENT_NAME": "slow"}


def test_a_reference_to_a_default_is_filled_in_as_the_commands_do_it(folder):
    (folder / "run.env").write_text("DR_UPLOAD_S3_PREFIX=up/$DR_LOCAL_S3_MODEL_PREFIX\n")

    assert activated(folder)["DR_UPLOAD_S3_PREFIX"] == "up/rl-deepracer-sagemaker"


def test_a_reference_to_nothing_is_empty_and_a_warning(folder):
    (folder / "run.env").write_text("MY_BUCKET=$NOBODY_KNOWS\n")

    change = shell_change(folder, {})

    assert change.export["MY_BUCKET"] == ""
    assert "run.env line 1" in change.warnings[0]


def test_a_line_edited_after_activation_counts(folder):
    shell = activated(folder)
    (folder / "run.env").write_text("DR_WORLD_NAME=bean\nDR_LOCAL_S3_MODEL_PREFIX=second\n")

    settings = load_settings(folder, environ=shell)

    assert (settings.world_name, settings.model_prefix) == ("bean", "second")
    assert settings.source("DR_WORLD_NAME") == "run.env line 1"


def test_a_value_exported_after_activation_wins_over_the_file(folder):
    shell = {**activated(folder), "DR_WORLD_NAME": "bean"}

    settings = load_settings(folder, environ=shell)

    assert settings.world_name == "bean"
    assert settings.source("DR_WORLD_NAME") == "environment"


def test_a_value_exported_by_hand_survives_the_next_activation(folder):
    shell = {**activated(folder), "DR_WORLD_NAME": "bean"}

    again = activated(folder, **shell)

    assert again["DR_WORLD_NAME"] == "bean"
    assert load_settings(folder, environ=again).world_name == "bean"


def test_activation_leaves_no_setting_that_only_it_knows(folder):
    shell = activated(folder)

    settings = load_settings(folder, environ=shell)

    assert not [warning for warning in settings.warnings if activation.MARK in warning]
    assert activation.MARK not in settings.extra


def test_a_name_that_left_the_files_is_unset_unless_somebody_changed_it(folder):
    shell = {**activated(folder), "DR_REGULAR_UPLOAD": "5"}
    (folder / "run.env").write_text("DR_WORLD_NAME=reinvent_base\n")

    change = shell_change(folder, shell)

    assert change.unset == ("DR_LOCAL_S3_METRICS_PREFIX", "DR_LOCAL_S3_MODEL_PREFIX", "MY_OWN")


def test_activating_again_changes_nothing(folder):
    once = activated(folder)

    assert activated(folder, **once) == once


def test_an_experiment_brings_its_own_run_env(folder, experiment):
    change = shell_change(folder, {}, experiment=experiment)

    assert change.export["DR_EXPERIMENT_NAME"] == "fast"
    assert change.export["DR_LOCAL_S3_MODEL_PREFIX"] == "quick"
    assert change.export["DR_CONFIG"] == str(folder / "experiments" / "fast" / "run.env")
    assert load_settings(folder, environ=dict(change.export)).model_prefix == "quick"


def test_an_experiment_is_left_by_unsetting_its_name(folder, experiment):
    shell = dict(shell_change(folder, {}, experiment=experiment).export)
    del shell["DR_EXPERIMENT_NAME"]

    change = shell_change(folder, shell)

    assert change.export["DR_LOCAL_S3_MODEL_PREFIX"] == "first"


def test_a_misspelt_experiment_is_refused_with_the_likely_one(folder, experiment):
    with pytest.raises(SettingsError, match="DR_EXPERIMENT_NAME=fats has no") as refusal:
        shell_change(folder, {}, experiment="fats")

    assert "Did you mean fast?" in refusal.value.remedy


def test_another_file_can_take_the_place_of_run_env(folder, tmp_path_factory):
    other = tmp_path_factory.mktemp("elsewhere") / "other.env"
    other.write_text("DR_LOCAL_S3_MODEL_PREFIX=other\n")
    (folder / "evening.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=evening\n")

    def with_file(path: Path) -> dict[str, str]:
        asked = {"DR_DIR": str(folder), "DR_CONFIG": str(path)}
        return {**asked, **shell_change(folder, asked).export}

    outside, inside = with_file(other), with_file(folder / "evening.env")

    assert load_settings(folder, environ=outside).model_prefix == "other"
    assert active_run_file(folder, environ=outside) == str(other)
    assert load_settings(folder, environ=inside).model_prefix == "evening"
    assert active_run_file(folder, environ=inside) == "evening.env"


def test_an_experiment_wins_over_another_file(folder, experiment):
    shell = activated(folder)

    shell = {**shell, **shell_change(folder, shell, experiment=experiment).export}

    assert load_settings(folder, environ=shell).model_prefix == "quick"


def test_a_shell_activated_for_another_folder_does_not_count(folder, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=theirs\n")

    settings = load_settings(elsewhere, environ=activated(folder))

    assert settings.model_prefix == "theirs"


def test_a_line_that_cannot_be_read_is_refused_with_its_place(folder):
    (folder / "run.env").write_text("DR_WORLD_NAME=bean\nnonsense\n")

    with pytest.raises(SettingsError, match=r"run\.env line 2"):
        shell_change(folder, {})


def test_the_script_quotes_whatever_a_shell_would_touch(folder):
    script = shell_change(folder, {}).script()

    assert "export MY_OWN='two words; $HOME'\n" in script
    assert all(len(shlex.split(line)) == 2 for line in script.splitlines())
