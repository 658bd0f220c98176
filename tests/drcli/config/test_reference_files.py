"""Files written for the reference load as they are, and damaged ones never crash."""

import contextlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import settings as limits
from hypothesis import strategies as st

from drcli.base.errors import SettingsError
from drcli.config.loading import load_settings
from drcli.config.settings import catalogue

REFERENCE = Path(__file__).resolve().parents[2] / "data" / "reference"
"""The reference's own run.env and system.env, as its installer writes them."""

REFERENCE_RUN = (REFERENCE / "run.env").read_text()
REFERENCE_SYSTEM = (REFERENCE / "system.env").read_text()


def test_the_files_of_the_reference_load_without_a_word(folder):
    folder.write("system.env", REFERENCE_SYSTEM)

    settings = folder.load(REFERENCE_RUN)

    assert settings.warnings == ()
    assert settings.extra == {}
    assert settings.metrics_prefix == "rl-deepracer-sagemaker/metrics"
    assert settings.reward_key == "custom_files/reward_function.py"
    assert settings.display_name == "FastCar"
    assert settings.upload_s3_prefix == "rl-deepracer-sagemaker-1"


def test_the_defaults_are_the_values_of_the_reference(folder):
    written = folder.load(REFERENCE_RUN)

    silent = folder.load("")

    # Its evaluations of five laps say too little about a checkpoint.
    assert (silent.eval_laps, written.eval_laps) == (20, 5)
    same = {"written": {}, "sources": {}, "problems": (), "train_min_eval_trials": 5}
    assert silent.replaced(**same) == written.replaced(**same)


def test_the_examples_of_the_project_load_without_a_warning():
    root = Path(__file__).resolve().parents[3]

    settings = load_settings(root, environ={})

    assert settings.warnings == ()
    assert settings.workers == 1


def test_a_flag_moves_what_the_files_derive_from_its_name(folder):
    settings = folder.load(REFERENCE_RUN, flags={"DR_LOCAL_S3_MODEL_PREFIX": "other"})

    assert settings.metrics_prefix == "other/metrics"


@limits(max_examples=60)
@given(data=st.data())
def test_a_damaged_file_is_loaded_or_refused_and_nothing_else(folder, travelled, data):
    text = REFERENCE_RUN.encode()
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        junk = data.draw(st.binary(max_size=6) | st.sampled_from([b"$", b"=", b"'", b"\n", b"${"]))
        text = text[:at] + junk + text[at + data.draw(st.integers(0, 30)) :]

    with contextlib.suppress(SettingsError):
        settings = folder.load(text)

        assert travelled(settings.run) == settings.run


@limits(max_examples=60)
@given(
    environ=st.dictionaries(
        st.sampled_from(sorted(catalogue())),
        st.text(st.characters(exclude_characters="\0"), max_size=12),
        max_size=5,
    )
)
def test_any_environment_is_accepted_or_refused_and_nothing_else(travelled, environ):
    root = Path(__file__).resolve().parents[3]

    with contextlib.suppress(SettingsError):
        settings = load_settings(root, environ=environ)

        assert travelled(settings.run) == settings.run


@pytest.mark.parametrize("written", ["team/model-1/", "/team/model-1", "team//model-1//"])
def test_slashes_that_the_reference_takes_are_left_out_with_one_warning(folder, written):
    settings = folder.load(
        f"DR_LOCAL_S3_MODEL_PREFIX={written}\n"
        "DR_LOCAL_S3_METRICS_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX/metrics\n"
    )

    assert settings.model_prefix == "team/model-1"
    assert settings.metrics_prefix == "team/model-1/metrics"
    assert [text for text in settings.warnings if "slashes" in text] == [
        f"run.env line 1: DR_LOCAL_S3_MODEL_PREFIX={written} is read as team/model-1, without the "
        "extra slashes."
    ]


def test_azure_without_an_address_is_served_here_as_in_the_reference(folder):
    folder.write("system.env", "DR_CLOUD=azure\n")

    settings = folder.load("")

    assert settings.cloud == "local"
    [warning] = settings.warnings
    assert warning.startswith("system.env line 1: DR_CLOUD=azure without DR_REMOTE_MINIO_URL")


def test_azure_with_an_address_stays(folder):
    folder.write("system.env", "DR_CLOUD=azure\nDR_REMOTE_MINIO_URL=http://x:9000\n")

    settings = folder.load("")

    assert (settings.cloud, settings.warnings) == ("azure", ())
