"""What does nothing here is said once, with the reason."""

import pytest

from drcli.config.unused_names import harmless_summary, without_effect


def test_harmless_settings_share_one_sentence_which_only_checks_tell(folder):
    folder.write("system.env", "DR_DOCKER_STYLE=compose\nDR_HOST_X=True\nDR_DISPLAY=:99\n")

    settings = folder.load("DR_CAR_BODY_SHELL_TYPE=f1_2021\n")

    assert settings.warnings == ()
    assert str(harmless_summary(settings)) == (
        "run.env and system.env: 4 of the settings are for containers, windows, videos and the "
        "like, without effect here. `dr config check` names them."
    )


def test_what_somebody_counts_on_is_named_with_value_and_reason(folder):
    settings = folder.load("DR_KINESIS_STREAM_NAME=live\n")

    assert settings.warnings == (
        "run.env line 1: DR_KINESIS_STREAM_NAME=live has no effect: no camera stream is published.",
    )


@pytest.mark.parametrize("resets", [0, 1, 2])
def test_a_number_of_resets_that_the_reference_refuses_is_followed_and_told(folder, resets):
    settings = folder.load(f"DR_EVAL_MAX_RESETS={resets}\n")

    assert settings.eval_max_resets == resets
    assert any("the reference refuses 1" in text for text in settings.warnings) == (resets == 1)


def test_settings_that_miss_their_effect_for_one_reason_share_a_sentence(folder):
    settings = folder.load("DR_ROBOMAKER_MOUNT_SCRIPTS_DIR=/x\nDR_KINESIS_STREAM_NAME=live\n")

    assert settings.warnings == (
        "run.env line 1: DR_ROBOMAKER_MOUNT_SCRIPTS_DIR=/x has no effect: no containers are used.",
        "run.env line 2: DR_KINESIS_STREAM_NAME=live has no effect: no camera stream is published.",
    )


@pytest.mark.parametrize(
    "value", ["DR_TELEGRAF_HOST=", "DR_KINESIS_STREAM_NAME=", "DR_KINESIS_STREAM_NAME=False"]
)
def test_a_switch_that_is_off_is_missed_by_nobody(folder, value):
    settings = folder.load(f"{value}\n")

    assert not any("has no effect:" in text for text in settings.warnings)


def test_all_of_them_are_listed_by_reason(folder):
    folder.write("system.env", "DR_DOCKER_STYLE=swarm\nDR_MINIO_IMAGE=latest\nDR_WORKERS=2\n")

    groups = without_effect(folder.load("DR_KINESIS_STREAM_NAME=live\n"))

    assert [(group.reason, group.names) for group in groups] == [
        ("no containers are used", ("DR_MINIO_IMAGE", "DR_DOCKER_STYLE")),
        ("no camera stream is published", ("DR_KINESIS_STREAM_NAME",)),
    ]


def test_a_shell_in_which_the_reference_was_activated_makes_no_noise(folder):
    environ = {"DR_DOCKER_STYLE": "swarm", "DR_MINIO_URL": "http://minio:9000", "DR_CONFIG": "x"}

    assert folder.load("", environ=environ).warnings == ()
