"""The number at the end of a name in run.env."""

import pytest

from drcli.config.editing import raised


@pytest.mark.parametrize(
    ("text", "prefix", "delimiter", "after"),
    [
        ("rl-deepracer-1", "rl-deepracer-1", None, ("rl-deepracer-2", "rl-deepracer-2")),
        ("m-9", "m-9", None, ("m-10", "m-10")),
        ("m-99", "m-99", None, ("m-100", "m-100")),
        ("m-09", "m-09", None, ("m-10", "m-10")),
        ("model7", "model7", None, ("model8", "model8")),
        ("model7", "model7", "-", ("model7-1", "model7-1")),
        ("m_3", "m_3", "_", ("m_4", "m_4")),
        ("rl-sagemaker", "rl-sagemaker", None, ("rl-sagemaker-1", "rl-sagemaker-1")),
        ("2024", "2024", None, ("2024-1", "2024-1")),
        ("team/model-3", "team/model-3", None, ("team/model-4", "team/model-4")),
        ("team/7", "team/7", None, ("team/8", "team/8")),
        ("$W/first", "oval/first", None, ("$W/first-1", "oval/first-1")),
        ("$W/m-2", "oval/m-2", None, ("$W/m-3", "oval/m-3")),
        ("m-$A7", "m-5", None, ("m-$A7-1", "m-5-1")),
        ("m-$A", "m-5", "_", ("m-${A}_1", "m-5_1")),
        ("m-${A}9", "m-29", None, ("m-${A}10", "m-210")),
    ],
)
def test_the_number_at_the_end_is_raised(text, prefix, delimiter, after):
    assert raised(text, prefix, delimiter) == after
