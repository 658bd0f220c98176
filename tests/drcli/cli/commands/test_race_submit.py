"""`dr race submit RACE MODEL`."""

import pytest


@pytest.fixture
def submitted(monkeypatch):
    """Prefixes of the models that were submitted."""
    prefixes = []

    def submit(*_, prefix, **__):
        prefixes.append(prefix)
        raise KeyboardInterrupt

    monkeypatch.setattr("drcli.races.submissions.submit", submit)
    monkeypatch.setattr("drcli.cli.commands.race.found_race", lambda _, race: (None, race))
    return prefixes


@pytest.mark.parametrize(
    ("words", "prefix"),
    [("", None), ("team/model-7", "team/model-7"), ("-p team/model-7", "team/model-7")],
)
def test_the_model_is_named_after_the_race_or_by_its_option(
    dr, working_folder, submitted, words, prefix
):
    dr("race", "submit", "cup", *words.split())

    assert submitted == [prefix]


def test_a_model_that_is_named_twice_is_refused(dr, working_folder, submitted, capsys):
    code = dr("race", "submit", "cup", "a", "--prefix", "b")

    assert (code, submitted) == (2, [])
    assert "MODEL and --prefix both name the model; use only one." in capsys.readouterr().err
