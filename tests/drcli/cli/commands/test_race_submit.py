"""`dr race submit RACE MODEL` and `dr race run RACE`."""

from types import SimpleNamespace

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


@pytest.mark.parametrize("waiting", [0, 2])
def test_a_queue_in_which_nothing_waits_says_so(dr, working_folder, monkeypatch, capsys, waiting):
    def drive(*_, on_progress, **__):
        for number in range(waiting):
            on_progress(f"Driving {number} ...")

    monkeypatch.setattr("drcli.cli.commands.race.found_race", lambda _, race: (None, race))
    monkeypatch.setattr("drcli.cli.commands.race.bring_tracks", lambda _: None)
    monkeypatch.setattr("drcli.cli.commands.race.print_race", lambda _: None)
    queue = SimpleNamespace(race_conditions=lambda *_: None, run_queue=drive)
    monkeypatch.setattr("drcli.cli.commands.race.race_queue", queue)

    code = dr("race", "run", "cup")

    said = capsys.readouterr().err
    assert code == 0
    assert said.count("Driving") == waiting
    assert ("Nothing waits in the queue of cup." in said) is (waiting == 0)
    assert ("dr-race submit cup MODEL" in said) is (waiting == 0)
