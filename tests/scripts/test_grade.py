"""Marks of a course project: what they are made of, and what a bad submission gets."""

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import grade
import pytest

COURSE = grade.Course({"bean": 14.0, "paddle": 20.0}, {"willow": 30.0}, laps=10, seed=3)
READY_MADE = Path(__file__).resolve().parents[2] / "defaults/models/safe"


def row(world, clean, median_s, reason=""):
    return {"world": world, "clean": clean, "median_s": median_s, "reason": reason}


ROWS = [row("bean", 10, 8.0), row("paddle", 5, None), row("willow", 2, 20.0)]


@pytest.fixture
def submission(tmp_path):
    """A complete one."""
    folder = tmp_path / "submissions" / "ann"
    folder.mkdir(parents=True)
    for name in (*grade.FILES, "model.tar.gz"):
        (folder / name).write_text(f"{name} of ann")
    return folder


@pytest.fixture
def work(tmp_path):
    (tmp_path / "work" / "custom_files").mkdir(parents=True)
    return tmp_path / "work"


class Told:
    """A `dr` that does nothing, notes what it is asked for, and may refuse a command."""

    def __init__(self, rows=ROWS, **refused):
        self.called = []
        self._rows = rows
        self._refused = refused

    def __call__(self, *words):
        self.called.append(words)
        return {"rows": self._rows}, self._refused.get(words[0], "")


def test_marks_are_those_of_the_page(submission, work):
    marks = grade.grade(submission, work, COURSE, Told())

    assert marks.files == 10
    assert marks.announced == pytest.approx(20 * (1.0 + 0.5) / 2)
    assert marks.hidden == pytest.approx(20 * 0.2)
    # 14 m in 8 s are 1.75 m/s, half of the way from 1 to 2.5; on the other track no lap was clean.
    assert marks.pace == pytest.approx(10 * 0.5 / 2)
    assert marks.total == pytest.approx(10 + 15 + 4 + 2.5)
    assert marks.note == ""


@pytest.mark.parametrize(("median_s", "pace"), [(1.0, 10.0), (100.0, 0.0)])
def test_pace_has_a_greatest_and_a_least_mark(median_s, pace):
    course = grade.Course({"bean": 14.0}, {"willow": 30.0}, laps=10, seed=0)
    rows = {"bean": row("bean", 10, median_s), "willow": row("willow", 0, None)}

    assert grade.marks_of("ann", rows, course).pace == pace


def test_the_files_that_are_examined_are_those_of_the_submission(submission, work):
    dr = Told()

    grade.grade(submission, work, COURSE, dr)

    examined, imported, driven = dr.called
    assert examined == ("validate",)
    for name in grade.FILES:
        assert (work / "custom_files" / name).read_text() == f"{name} of ann"
    assert str(submission / "model.tar.gz") in imported
    assert str(submission / "model_metadata.json") in imported
    assert driven[driven.index("--worlds") + 1] == "bean,paddle,willow"
    assert driven[driven.index("--laps") + 1] == "10"
    assert driven[driven.index("--seed") + 1] == "3"


def _without(name):
    return lambda folder: (folder / name).unlink()


@pytest.mark.parametrize(
    ("spoil", "note"),
    [
        (_without("reward_function.py"), "reward_function.py is missing."),
        (_without("model.tar.gz"), "There must be one archive of the model, not 0."),
        (
            lambda folder: (folder / "other.zip").touch(),
            "There must be one archive of the model, not 2.",
        ),
        (
            lambda folder: (
                (folder / "model.tar.gz").unlink()
                or (folder / "model.tar.gz").symlink_to("/etc/hosts")
            ),
            "There must be one archive of the model, not 0.",
        ),
    ],
)
def test_an_incomplete_submission_gets_a_sentence_and_no_marks(submission, work, spoil, note):
    spoil(submission)
    dr = Told()

    marks = grade.grade(submission, work, COURSE, dr)

    assert (marks.total, marks.note, dr.called) == (0.0, note, [])


def test_a_file_among_the_folders_gets_a_sentence(submission, work):
    (submission.parent / "bob.zip").touch()

    marks = grade.grade(submission.parent / "bob.zip", work, COURSE, Told())

    assert (marks.total, marks.note) == (0.0, "bob.zip is not a folder.")


@pytest.mark.parametrize("command", ["validate", "import", "evaluate"])
def test_what_a_command_refuses_gets_its_sentence_and_no_marks(submission, work, command):
    dr = Told(**{command: f"{submission}/model.tar.gz\nis damaged."})

    marks = grade.grade(submission, work, COURSE, dr)

    assert (marks.total, marks.note) == (0.0, "model.tar.gz is damaged.")
    assert dr.called[-1][0] == command


def test_a_model_that_cannot_be_driven_on_a_track_gets_no_marks(submission, work):
    dr = Told([*ROWS[:2], row("willow", 0, None, reason="It has no checkpoint.")])

    marks = grade.grade(submission, work, COURSE, dr)

    assert (marks.total, marks.note) == (0.0, "It has no checkpoint.")


def test_the_table_has_a_row_for_each_and_no_formulas(tmp_path):
    table = [
        grade.Marks("ann", 10, 20, 5, 2.5, {"bean": 1.0, "paddle": 1.0, "willow": 0.25}),
        grade.Marks("=1+1", note="It is, in a word, damaged."),
    ]

    grade.write(tmp_path / "marks.csv", table, COURSE)

    with (tmp_path / "marks.csv").open(newline="") as file:
        ann, bob = csv.DictReader(file)
    assert (ann["total"], ann["hidden"], ann["clean laps on willow"]) == ("37.5", "5.0", "25%")
    assert (bob["submission"], bob["total"], bob["clean laps on bean"]) == ("'=1+1", "0.0", "")
    assert bob["note"] == "It is, in a word, damaged."


def test_a_command_that_fails_tells_its_reason_and_the_shells_settings_do_not_count(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("DR_WORLD_NAME", "nowhere")
    dr = grade.partial(grade.run_dr, tmp_path, None)

    told, reason = dr("init", ".", "--world", "bean", "--prefix", "submission")
    assert (told["folder"], reason) == (str(tmp_path), "")
    assert "DR_WORLD_NAME=bean" in (tmp_path / "run.env").read_text()

    _, reason = dr("tracks", "show", "nowhere")
    assert reason == "There is no track nowhere here."


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["nowhere", "--announced", "bean", "--hidden", "willow"], "nowhere is not a folder"),
        ([".", "--announced", "bean", "--hidden", "bean"], "bean is announced and hidden"),
        ([".", "--announced", "bean", "--hidden", "nowhere"], "There is no track nowhere here."),
    ],
)
def test_a_wrong_call_is_refused_in_a_sentence(tmp_path, monkeypatch, capsys, words, told):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["grade.py", *words])

    with pytest.raises(SystemExit, match="2"):
        grade.main()

    assert told in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.nightly
def test_a_real_class_is_marked(tmp_path):
    """With a ready-made model, and one submission for each step that can refuse it."""
    dr = grade.partial(grade.run_dr, tmp_path, None)
    assert dr("init", ".", "--model", "safe", "--prefix", "safe")[1] == ""
    assert dr("export", "car", "-o", "model.tar.gz")[1] == ""
    dr("stop-all")
    for name in ("good", "raises", "truncated", "others"):
        folder = tmp_path / "submissions" / name
        folder.mkdir(parents=True)
        for file in grade.FILES:
            shutil.copy(READY_MADE / file, folder / file)
        shutil.copy(tmp_path / "model.tar.gz", folder / "model.tar.gz")
    submissions = tmp_path / "submissions"
    (submissions / "raises/reward_function.py").write_text("def reward_function(params): 1 / 0\n")
    archive = (tmp_path / "model.tar.gz").read_bytes()
    (submissions / "truncated/model.tar.gz").write_bytes(archive[: len(archive) // 2])
    metadata = json.loads((READY_MADE / "model_metadata.json").read_text())
    metadata["action_space"] = metadata["action_space"][:2]
    (submissions / "others/model_metadata.json").write_text(json.dumps(metadata))

    words = ["--announced", "reinvent_base", "--hidden", "willow", "--laps", "4"]
    script = Path(grade.__file__)
    ended = subprocess.run(
        [sys.executable, script, submissions, *words, "-o", tmp_path / "marks.csv"],
        capture_output=True,
        text=True,
    )

    assert (ended.returncode, "Traceback" in ended.stderr) == (0, False)
    with (tmp_path / "marks.csv").open(newline="") as file:
        rows = {row["submission"]: row for row in csv.DictReader(file)}
    assert float(rows["good"]["total"]) > 45
    assert rows["good"]["note"] == ""
    assert "ZeroDivisionError" in rows["raises"]["note"]
    assert rows["truncated"]["note"] == "model.tar.gz is truncated."
    assert "2 discrete actions" in rows["others"]["note"]
    assert {rows[name]["total"] for name in ("raises", "truncated", "others")} == {"0.0"}
