"""`dr analyze --explain` as its caller meets it: only a model of the bucket can be explained."""

import json
import re

import pytest

from drcli.analysis import read_run
from simtraces import episode, put, trace, with_reset, write_model


@pytest.fixture
def never_read(monkeypatch):
    for name in ("read_run", "read_runs"):
        monkeypatch.setattr(read_run, name, lambda *given, **options: pytest.fail("too early"))


@pytest.mark.parametrize("name", ["models/mine", "./models/mine", "../away/mine", "s3://b/mine"])
def test_only_a_model_of_the_bucket_is_explained(dr, working_folder, never_read, capsys, name):
    trace = working_folder / "models" / "mine" / "training-simtrace" / "0-iteration.csv"
    trace.parent.mkdir(parents=True)
    trace.write_text("episode,steps\n")

    assert dr("analyze", name, "--explain", "--html", "report.html") == 2

    assert f"--explain drives a model of the bucket, and {name} is not one" in " ".join(
        capsys.readouterr().err.split()
    )
    assert not (working_folder / "report.html").exists()


def test_explaining_an_unknown_model_says_that_there_is_none(dr, working_folder, capsys):
    assert dr("analyze", "nothing", "--explain", "--html", "report.html") != 0

    assert "bucket" in capsys.readouterr().err
    assert not (working_folder / "report.html").exists()


def test_a_path_that_does_not_exist_is_named_outside_a_working_folder(
    dr, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DR_DIR", raising=False)

    for arguments in (["analyze", "./gone"], ["video", "./gone.csv", "--gif"]):
        assert dr(*arguments) == 3

        assert "./gone" in (told := capsys.readouterr().err)
        assert "does not exist" in told
        assert "run.env" not in told


def test_an_archive_that_does_not_exist_is_not_looked_for_in_the_bucket_only(
    dr, working_folder, capsys
):
    assert dr("analyze", "gone.zip") == 3

    assert "gone.zip does not exist" in capsys.readouterr().err


@pytest.fixture
def models(working_folder):
    """Two small models in the working folder."""
    for name, laps_from in (("slow", None), ("fast", 1)):
        write_model(working_folder / name, iterations=4, laps_from=laps_from)
    return "./slow", "./fast"


def test_a_lap_with_resets_is_no_clean_lap_on_the_terminal_in_json_and_in_the_report(
    dr, working_folder, capsys
):
    folder = write_model(working_folder / "helped", iterations=1, evaluations=0)
    lap = with_reset(episode(0, 118, progress=100.0, phase="evaluation"), at=60, pause_steps=75)
    name = "evaluation-20260102030400/evaluation-simtrace/0-iteration.csv"
    put(folder, name, trace([lap]))
    page = working_folder / "report.html"

    assert dr("analyze", "./helped", "--html", str(page)) == 0

    told = " ".join(capsys.readouterr().out.split())
    time = "12.87 s = 7.87 driven + 5.00 penalty"
    assert f"0 of 1 lap clean (1 reset), 1 finished, the fastest in {time}, 1 reset" in told
    row = re.sub(r"<[^>]*>", "|", page.read_text().partition("Evaluations, the oldest")[2])
    assert "|1||0||1||1|" in re.sub(r"\s", "", row)  # laps, clean, finished, resets
    assert dr("analyze", "./helped", "--json") == 0
    [evaluation] = json.loads(capsys.readouterr().out)["evaluations"]
    assert (evaluation["clean_laps"], evaluation["complete_laps"]) == (0, 1)
    assert (evaluation["best_lap_s"], evaluation["resets"]) == (None, 1)
    assert evaluation["trials"][0]["penalty_s"] == pytest.approx(5.0)


def test_a_comparison_is_shown_and_written_as_a_page(dr, working_folder, models, capsys):
    page = working_folder / "compare.html"
    put(working_folder / "fast", "ip/hyperparameters.json", b'{"lr": 0.001}')

    assert dr("analyze", "compare", *models, "--html", str(page)) == 0

    assert "slow and fast compared" in page.read_text()
    shown = capsys.readouterr().out
    assert "hyperparameters.json: slow (-), fast (+)\n  @@ -1," in shown
    assert "Wrote" in shown


def test_a_comparison_replaces_no_other_file(dr, working_folder, models, never_read, capsys):
    notes = working_folder / "notes.txt"
    notes.write_text("mine")

    assert dr("analyze", "compare", *models, "--html", str(notes)) == 3

    assert "exists already" in " ".join(capsys.readouterr().err.split())
    assert notes.read_text() == "mine"


def test_one_model_cannot_be_compared_with_itself(dr, models, capsys):
    assert dr("analyze", "compare", models[0], "slow/") == 3

    error = " ".join(capsys.readouterr().err.split())
    assert "./slow and slow/ are the same model (slow), so there is nothing to compare" in error


def test_what_comes_next_analyses_the_same_model(dr, working_folder, models, capsys):
    (working_folder / "slow").rename(working_folder / "my slow")

    assert dr("analyze", "./my slow", "-L") == 0

    assert "    dr-analyze './my slow' -L --html report.html\n" in capsys.readouterr().err
