"""One parser reads every way to name a checkpoint (001-46, 003-16)."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drcli.base.errors import BadValue
from drcli.config.value_types import WORDS, parse_checkpoint


@pytest.mark.parametrize(
    ("text", "choice"),
    [
        ("last", "last"),
        (" Best ", "best"),
        ("FIRST_LAP", "first-lap"),
        ("three-laps", "three-laps"),
        ("12", 12),
        ("0", 0),
        ("007", 7),
        ("12_Step-7824.ckpt", 12),
        ("12_Step-7824", 12),
    ],
)
def test_a_word_a_number_or_a_name_is_read(text, choice):
    assert parse_checkpoint(text) == choice


@pytest.mark.parametrize("text", ["", "-1", "1.5", "frst-lap", "12_Step", "best 3", "9" * 11, "٣"])
def test_anything_else_is_refused_with_the_words(text):
    with pytest.raises(BadValue) as caught:
        parse_checkpoint(text)

    assert all(word in caught.value.remedy for word in WORDS)


def test_a_likely_word_is_offered():
    with pytest.raises(BadValue) as caught:
        parse_checkpoint("frist-lap")

    assert caught.value.remedy.startswith("Did you mean first-lap?")


@given(st.sampled_from(WORDS) | st.integers(0, 10**9))
def test_what_is_written_is_read_again(choice):
    assert parse_checkpoint(str(choice)) == choice


def test_settings_take_words_and_numbers(folder):
    settings = folder.load("DR_EVAL_CHECKPOINT=First-Lap\nDR_LOCAL_S3_PRETRAINED_CHECKPOINT=12")

    assert (settings.eval_checkpoint, settings.pretrained_checkpoint) == ("first-lap", "12")
    assert settings.eval_opp_checkpoint == ""


def test_a_pretrained_model_continues_from_the_last_checkpoint_with_any_other_word(folder):
    settings = folder.load("DR_LOCAL_S3_PRETRAINED=True\nDR_LOCAL_S3_PRETRAINED_CHECKPOINT=bets")

    [warning] = settings.warnings
    assert settings.pretrained_checkpoint == "last"
    assert "run.env line 2" in warning
    assert "last is used instead" in warning


def test_a_wrong_word_names_its_line(folder):
    error = folder.refusal("\nDR_EVAL_CHECKPOINT=newest")

    assert "run.env line 2" in str(error)
    assert "DR_EVAL_CHECKPOINT=newest is neither the number of a checkpoint" in str(error)
